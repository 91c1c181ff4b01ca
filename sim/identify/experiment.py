"""Data of a recording for identification: positions, forces, encoder step."""

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

# A gap of up to this many ticks, in which the driver overran, does not end a segment: the forces
# held meanwhile and the motion are known [ticks].
BRIDGED = 50
SHORTEST = 400  # shortest run of ticks that can identify a device [ticks]


@dataclass(frozen=True)
class Experiment:
    """One axis of a run."""

    period: float  # sampling period T [s]
    position: Array  # measured position at each tick [m], shape (N,)
    # first tick and end of each segment without a long gap: indices into `position`, shape (s, 2)
    segments: tuple[tuple[int, int], ...]
    # when each force was handed to the device [ticks since the first position], ascending, shape
    # (M,)
    at: Array
    force: Array  # the force handed over then, held until the next [N], shape (M,)
    # delay of each answered tick, including late ones, as measured by the driver, without the
    # device's own [ticks], shape (D,)
    delay: Array
    axis: str = "x"  # ``x``, ``y`` or ``z``
    # ticks whose position was not sampled, shape (N,), or None: interpolated for the first guess,
    # never compared with a model
    unread: NDArray[np.bool_] | None = None
    # ticks in which the answers of two earlier ticks may both have arrived, shape (N,), or None;
    # the driver reports the first and last change of the force and the mean only
    late: NDArray[np.bool_] | None = None

    @property
    def missing(self) -> NDArray[np.bool_]:
        """Whether the position of each tick was not sampled, shape (N,)."""
        return (
            np.zeros(len(self.position), dtype=bool)
            if self.unread is None
            else self.unread
        )


def lockstep(
    period: float, position: Array, force: Array, delay: float = 0.0, axis: str = "x"
) -> Experiment:
    """Return the experiment of a run in which every tick was answered."""
    ticks = len(position)
    where, given = (
        np.asarray(position, dtype=np.float64),
        np.asarray(force, dtype=np.float64),
    )
    return Experiment(
        period,
        where,
        ((0, ticks),),
        np.arange(float(ticks)) + delay,
        given,
        np.full(ticks, delay),
        axis,
    )


def read(
    path: Path, axis: str | None = None, within: tuple[int, int] = (0, 2**53)
) -> Experiment:
    """Read one axis of a recording within a range of ticks.

    Without `axis`, the axis with the largest variation of force is used. Raise ValueError for too
    few ticks, long gaps or a driver that reports no `mean_force`.
    """
    recording = Recording(path)
    period = period_of(recording)
    states = [
        state
        for state in recording.messages(DEVICE_STATE)
        if within[0] <= state.seq < within[1]
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
            f"{path}: its driver reports no mean_force, so the forces within a tick are unknown;"
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
            f"{path}: no {SHORTEST} ticks without gaps between them; record to a faster disk, "
            "or for a shorter time"
        )
    missing = ~np.isin(ticks, seq - seq[0])
    answers = np.array([state.force_seq for state in states], dtype=np.int64)
    fresh = answers[1:] != answers[:-1]
    # Several ticks sampled between two answers: none of them was answered in its own time.
    skipped = (
        np.searchsorted(seq, answers[1:]) - np.searchsorted(seq, answers[:-1], "right")
        > 1
    )
    late = np.zeros(len(ticks), dtype=bool)
    late[seq[:-1][skipped & fresh & (answers[:-1] >= 0)] - seq[0]] = True
    late[handed.unsure - seq[0]] = True
    return Experiment(
        period,
        whole,
        segments,
        handed.at - seq[0],
        handed.force,
        handed.delay,
        axis,
        missing,
        late,
    )


MIN_VALUES = 8  # fewer different positions would lie on many grids
# tolerated distance of a position from the grid [share of the step]: rounding, not motion
STRAY = 0.02


def encoder(position: Array) -> Estimate:
    """Estimate the encoder step: the spacing of the grid that contains all positions [m]."""
    values = np.unique(position)
    if len(values) < MIN_VALUES:
        return Estimate(
            None,
            why=(
                f"only {len(values)} different positions, at least {MIN_VALUES} are needed: move"
                " it more"
            ),
        )
    gaps = np.diff(values)
    # Values closer than a millionth of the median distance are equal up to rounding.
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
                "the positions are on no regular grid: the encoder is very fine, or its axes "
                "differ from the message's"
            ),
        )
    # Rounding moves each reading by at most `stray`, which bounds the error of the spacing.
    error = (
        2.0
        * (stray + float(np.spacing(np.abs(values).max())))
        / float(counts[-1] - counts[0])
    )
    return Estimate(float(slope), float(slope) - error, float(slope) + error)
