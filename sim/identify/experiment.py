"""What a recording holds for identification: positions at ticks, the forces with the instant of each, the encoder's grid."""

import itertools
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from messages.topics import DEVICE_STATE
from nodes.base.setup import AXIS_INDEX
from nodes.recording.reader import Recording
from sim.arrays import Array, WholeArray
from sim.identify.identified import Estimate

# So many ticks that the driver slept through do not end a stretch: forces held meanwhile, and the motion is known [ticks].
BRIDGED = 50
SHORTEST = 400  # fewer ticks in a row tell no device [ticks]


@dataclass(frozen=True)
class Experiment:
    """One axis of a run."""

    period: float  # sampling period T [s]
    position: Array  # measured position at each tick [m], shape (N,)
    # First tick and end of each stretch without a long gap: indices into `position`, shape (s, 2).
    segments: tuple[tuple[int, int], ...]
    at: Array  # when each force was handed to the device [ticks since the first position], rising, shape (M,)
    force: Array  # the force handed over then, which holds until the next [N], shape (M,)
    # Delay of each answered tick as the driver measured it, the device's own not included [ticks], shape (D,).
    delay: Array
    axis: str = "x"  # ``x``, ``y`` or ``z``
    # Ticks whose position was not sampled: filled in for a first guess, never compared with a model, shape (N,), or None. None
    # for none.
    unread: NDArray[np.bool_] | None = None
    # Ticks in which the answers of two earlier ones may have been handed over too: the driver tells where the force changed
    # first and last, and the mean of all, shape (N,), or None for none.
    late: NDArray[np.bool_] | None = None

    @property
    def missing(self) -> NDArray[np.bool_]:
        """Whether a tick's position was not sampled, shape (N,)."""
        return np.zeros(len(self.position), dtype=bool) if self.unread is None else self.unread


def lockstep(period: float, position: Array, force: Array, delay: float = 0.0, axis: str = "x") -> Experiment:
    """Make an experiment of a run in which every tick was answered."""
    ticks = len(position)
    where, given = np.asarray(position, dtype=np.float64), np.asarray(force, dtype=np.float64)
    return Experiment(period, where, ((0, ticks),), np.arange(float(ticks)) + delay, given, np.full(ticks, delay), axis)


def read(path: Path, axis: str | None = None, within: tuple[int, int] = (0, 2**53)) -> Experiment:
    """Read one axis of a recording, from a tick to before another."""
    recording = Recording(path)
    rate = float(recording.manifest.get("rate_hz", 0.0))
    if not rate > 0.0:
        raise ValueError(f"{path}: its manifest tells no rate_hz")
    states = [state for state in recording.messages(DEVICE_STATE) if within[0] <= state.seq < within[1]]
    if len(states) < SHORTEST:
        raise ValueError(f"{path}: {len(states)} ticks recorded, at least {SHORTEST} are needed to identify a device")
    positions = np.array([state.position for state in states])
    forces = np.array([state.force for state in states])
    if axis is None:
        axis = "xyz"[int(np.argmax(forces.std(axis=0)))]
    column = AXIS_INDEX[axis]
    seq = np.array([state.seq for state in states], dtype=np.int64)
    age = np.array([state.age for state in states], dtype=np.float64)
    measured = np.array([state.delay for state in states])
    answers = np.array([state.force_seq for state in states], dtype=np.int64)
    fresh = np.concatenate([[False], answers[1:] != answers[:-1]])
    mean = np.array([state.mean_force[column] for state in states])
    if np.any(forces[:, column]) and not np.any(mean):
        raise ValueError(f"{path}: its driver tells no mean_force, so what acted within a tick is not known; record it again")
    changed = np.concatenate([[True], np.any(forces[1:] != forces[:-1], axis=1)])
    # A state tells of the tick before it. Its force was handed over `delay − age` into that tick; one that answers nothing
    # new (the driver's own damping after a silence) at the end of it.
    took = seq - 1 + np.where(fresh, measured - age, 1.0) - seq[0]
    overruns = np.array([state.overruns for state in states], dtype=np.int64)
    first = np.array([state.changed_at for state in states])
    at, force = _in_turn(seq - seq[0], overruns, first, took, forces[:, column], mean, fresh | changed)
    breaks = np.flatnonzero(np.diff(seq) > BRIDGED) + 1
    ends = [0, *breaks.tolist(), len(seq)]
    # Indices of `position` are ticks.
    ticks = np.arange(int(seq[-1] - seq[0]) + 1)
    whole = np.interp(ticks, seq - seq[0], positions[:, column])
    segments = tuple(
        (int(seq[first] - seq[0]), int(seq[last - 1] - seq[0]) + 1)
        for first, last in itertools.pairwise(ends)
        if last - first >= SHORTEST // 4
    )
    if sum(last - first for first, last in segments) < SHORTEST:
        raise ValueError(f"{path}: no {SHORTEST} ticks without gaps between them; record by a faster disk or a shorter run")
    delays = measured[fresh & (age == 0)]
    missing = ~np.isin(ticks, seq - seq[0])
    # Of the ticks sampled between two answers none was answered in its own time.
    skipped = np.searchsorted(seq, answers[1:]) - np.searchsorted(seq, answers[:-1], "right") > 1
    late = np.zeros(len(ticks), dtype=bool)
    late[seq[1:][skipped & fresh[1:] & (answers[:-1] >= 0)] - 1 - seq[0]] = True
    return Experiment(1.0 / rate, whole, segments, at, force, delays, axis, missing, late)


SAME = 1e-9  # forces closer than this part of the largest are one force: a mean is rounded


def _in_turn(
    ticks: WholeArray, overruns: WholeArray, first: Array, took: Array, last: Array, mean: Array, new: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """Put the forces of all ticks in turn: what must have acted between the first change of a tick and the last for its mean.

    The mean is over the ticks that the driver slept through too, which are overruns, and in which the device may let go;
    ticks that only the recording lacks had states of their own. When each is handed over [ticks], and the force [N], each of
    shape (M,).
    """
    covered = np.concatenate([[1], np.minimum(np.diff(ticks), 1 + np.diff(overruns))])
    begin, held = ticks - covered, np.concatenate([last[:1], last[:-1]])
    # Behind a gap nobody tells what was held until the first change.
    start = np.minimum(np.where(np.diff(ticks, prepend=ticks[0]) == 1, begin + first, begin), took)
    span, between = took - start, held.copy()
    given = mean * covered - held * (start - begin) - last * (ticks - took)
    np.divide(given, span, out=between, where=span > SAME)
    other = np.abs(between - held) > SAME * float(np.max(np.abs(last))) / np.maximum(span, SAME)
    used = np.stack([other, new], axis=1).ravel()
    at = np.maximum.accumulate(np.stack([start, took], axis=1).ravel()[used])
    return at, np.stack([between, last], axis=1).ravel()[used]


LEAST_VALUES = 8  # fewer different positions could lie on many grids
STRAY = 0.02  # how far from the grid a position may be, as a part of the step: rounding, not motion


def encoder(position: Array) -> Estimate:
    """Find the grid that all positions lie on: the distance of neighbouring readings [m]."""
    values = np.unique(position)
    if len(values) < LEAST_VALUES:
        return Estimate(None, why=f"only {len(values)} different positions, at least {LEAST_VALUES} are needed: move it more")
    gaps = np.diff(values)
    # Values closer than a millionth of the usual distance are one, rounded differently.
    gaps = gaps[gaps > 1e-6 * float(np.median(gaps))]
    counts = np.round(gaps / gaps.min())
    step = float(np.sum(gaps) / np.sum(counts))
    counts = np.round((values - values[0]) / step)
    slope, offset = np.polyfit(counts, values, 1)
    stray = float(np.max(np.abs(values - offset - slope * counts)))
    if not stray < STRAY * slope:
        return Estimate(
            None, why="the positions lie on no even grid: the encoder is fine, or its axes are not those of the message"
        )
    # Rounding moves each reading by at most `stray`, so the two ends of the grid leave this much room.
    error = 2.0 * (stray + float(np.spacing(np.abs(values).max()))) / float(counts[-1] - counts[0])
    return Estimate(float(slope), float(slope) - error, float(slope) + error)
