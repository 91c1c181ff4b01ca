"""What a recording holds for identification: positions at ticks, the forces with the instant of each, the encoder's grid."""

import itertools
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from messages.topics import DEVICE_STATE
from nodes.base.setup import AXIS_INDEX
from nodes.recording.facts import period_of
from nodes.recording.reader import Recording
from sim.arrays import Array
from sim.identify.forces import handed_over
from sim.identify.identified import Estimate

# So many ticks that the driver slept through do not end a stretch: forces held meanwhile, and the
# motion is known [ticks].
BRIDGED = 50
SHORTEST = 400  # fewer ticks in a row tell no device [ticks]


@dataclass(frozen=True)
class Experiment:
    """One axis of a run."""

    period: float  # sampling period T [s]
    position: Array  # measured position at each tick [m], shape (N,)
    # First tick and end of each stretch without a long gap: indices into `position`, shape (s, 2).
    segments: tuple[tuple[int, int], ...]
    # when each force was handed to the device [ticks since the first position], rising, shape (M,)
    at: Array
    force: Array  # the force handed over then, which holds until the next [N], shape (M,)
    # Delay of each answered tick, late ones too, as the driver measured it, the device's own not
    # included [ticks], shape (D,).
    delay: Array
    axis: str = "x"  # ``x``, ``y`` or ``z``
    # Ticks whose position was not sampled: filled in for a first guess, never compared with a
    # model, shape (N,), or None. None for none.
    unread: NDArray[np.bool_] | None = None
    # Ticks in which the answers of two earlier ones may have been handed over too: the driver tells
    # where the force changed first and last, and the mean of all, shape (N,), or None for none.
    late: NDArray[np.bool_] | None = None

    @property
    def missing(self) -> NDArray[np.bool_]:
        """Whether a tick's position was not sampled, shape (N,)."""
        return np.zeros(len(self.position), dtype=bool) if self.unread is None else self.unread


def lockstep(
    period: float, position: Array, force: Array, delay: float = 0.0, axis: str = "x"
) -> Experiment:
    """Make an experiment of a run in which every tick was answered."""
    ticks = len(position)
    where, given = np.asarray(position, dtype=np.float64), np.asarray(force, dtype=np.float64)
    return Experiment(
        period,
        where,
        ((0, ticks),),
        np.arange(float(ticks)) + delay,
        given,
        np.full(ticks, delay),
        axis,
    )


def read(path: Path, axis: str | None = None, within: tuple[int, int] = (0, 2**53)) -> Experiment:
    """Read one axis of a recording, from a tick to before another."""
    recording = Recording(path)
    period = period_of(recording)
    states = [
        state for state in recording.messages(DEVICE_STATE) if within[0] <= state.seq < within[1]
    ]
    if len(states) < SHORTEST:
        raise ValueError(
            f"{path}: {len(states)} ticks recorded, at least {SHORTEST} are needed to identify a"
            " device"
        )
    positions = np.array([state.position for state in states])
    if axis is None:
        axis = "xyz"[int(np.argmax(np.std([state.force for state in states], axis=0)))]
    column = AXIS_INDEX[axis]
    seq = np.array([state.seq for state in states], dtype=np.int64)
    if any(state.force[column] for state in states) and not any(
        state.mean_force[column] for state in states
    ):
        raise ValueError(
            f"{path}: its driver tells no mean_force, so what acted within a tick is not known;"
            " record it again"
        )
    handed = handed_over(states, column)
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
        raise ValueError(
            f"{path}: no {SHORTEST} ticks without gaps between them; record by a faster disk or a"
            " shorter run"
        )
    missing = ~np.isin(ticks, seq - seq[0])
    answers = np.array([state.force_seq for state in states], dtype=np.int64)
    fresh = answers[1:] != answers[:-1]
    # Of the ticks sampled between two answers none was answered in its own time.
    skipped = np.searchsorted(seq, answers[1:]) - np.searchsorted(seq, answers[:-1], "right") > 1
    late = np.zeros(len(ticks), dtype=bool)
    late[seq[:-1][skipped & fresh & (answers[:-1] >= 0)] - seq[0]] = True
    late[handed.unsure - seq[0]] = True
    return Experiment(
        period, whole, segments, handed.at - seq[0], handed.force, handed.delay, axis, missing, late
    )


LEAST_VALUES = 8  # fewer different positions could lie on many grids
STRAY = 0.02  # how far from the grid a position may be, as a part of the step: rounding, not motion


def encoder(position: Array) -> Estimate:
    """Find the grid that all positions lie on: the distance of neighbouring readings [m]."""
    values = np.unique(position)
    if len(values) < LEAST_VALUES:
        return Estimate(
            None,
            why=(
                f"only {len(values)} different positions, at least {LEAST_VALUES} are needed: move"
                " it more"
            ),
        )
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
            None,
            why=(
                "the positions lie on no even grid: the encoder is fine, or its axes are not those"
                " of the message"
            ),
        )
    # Rounding moves each reading by at most `stray`, so the two ends of the grid leave this much
    # room.
    error = 2.0 * (stray + float(np.spacing(np.abs(values).max()))) / float(counts[-1] - counts[0])
    return Estimate(float(slope), float(slope) - error, float(slope) + error)
