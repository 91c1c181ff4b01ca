"""Forces a driver handed to its device, with their instants, rebuilt from its states.

Used for identification and for replays. A state reports the tick before it: when the force changed
first (`changed_at`) and last (`delay − age`), the last force, and the mean force since the previous
position. So one more force can be derived: that of an earlier answer, or the answer's own before
the guard lowered it at the end of the tick. If there is none, the mean gives the instant at which
the device released the force itself, or at which the last force arrived in ticks missed by an
overrun.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from messages.types import DeviceState
from sim.arrays import Array, WholeArray

SAME = 1e-9  # forces closer than this share of the largest are equal: a mean is rounded


@dataclass(frozen=True)
class HandedOver:
    """The forces of one axis in order of time."""

    at: Array  # when each was handed over [ticks], ascending, shape (M,)
    force: Array  # the force, held until the next [N], shape (M,)
    # tick that each force answers; −1 for the driver's own and if unknown, shape (M,)
    answers: WholeArray
    unsure: WholeArray  # ticks of which only the mean force is known, shape (U,)

    @property
    def delay(self) -> Array:
        """Return the delay from each answered tick, however late, to its force [ticks], (D,)."""
        answered = self.answers >= 0
        return self.at[answered] - self.answers[answered]


def handed_over(states: Sequence[DeviceState], axis: int) -> HandedOver:
    """Rebuild the forces of an axis from the states of a driver.

    If the driver reports no means (optional in PROTOCOL.md), only the last force of each tick is
    known.
    """
    strongest = max(abs(state.force[axis]) for state in states)
    has_means = not strongest or any(state.mean_force[axis] for state in states)
    same, first = SAME * strongest, states[0]
    told = [
        (first.seq - 1.0, first.mean_force[axis], -1),
        (float(first.seq), first.force[axis], -1),
    ]
    unsure: list[int] = []
    # tick of the newest position; in a fault there is none, and the mean continues
    since = first.seq
    for before, state in pairwise(states):
        # The mean covers overruns; ticks missing only in the recording had states of their own.
        covered = min(
            max(1 + state.overruns - before.overruns, 1), state.seq - before.seq
        )
        begin = state.seq - covered
        if not has_means:
            offset, answer = _last(before, state)
            told.append((begin + offset, state.force[axis], answer))
            unsure += range(begin, state.seq)
            continue
        if begin > before.seq:
            since, earlier = begin, 0.0
        else:
            since = since if before.safety == "fault" else before.seq
            earlier = before.mean_force[axis] * (before.seq - since)
        impulse = state.mean_force[axis] * (state.seq - since) - earlier
        changes, sure = _changes(before, state, axis, covered, impulse, same)
        told += [(begin + at, force, answers) for at, force, answers in changes]
        if not sure:
            unsure += range(begin, state.seq)
    used = told[:1]
    for one in told[1:]:
        if one[2] >= 0 or abs(one[1] - used[-1][1]) > same:
            used.append(one)
    at, force, answers = zip(*used, strict=True)
    return HandedOver(
        np.maximum.accumulate(at),
        np.array(force),
        np.array(answers, np.int64),
        np.array(unsure, np.int64),
    )


def _last(before: DeviceState, state: DeviceState) -> tuple[float, int]:
    """Return when the last force of a tick arrived [ticks] and the tick it answers.

    The instant is relative to the begin of the tick; −1 stands for the driver's own force.
    """
    if state.force_seq != before.force_seq and state.delay >= state.age:
        return min(state.delay - state.age, 1.0), state.force_seq
    return 1.0, -1


def _changes(
    before: DeviceState,
    state: DeviceState,
    axis: int,
    covered: int,
    impulse: float,
    same: float,
) -> tuple[list[tuple[float, float, int]], bool]:
    """Return the forces of the last tick before a state and of the overrun after it.

    Each force is given with its instant [ticks since that tick began] and the tick it answers. The
    second value is False if they are not certain. Together they give `impulse` [N ticks].
    """
    tick, slept = state.seq - covered, covered - 1
    held, last = before.force[axis], state.force[axis]
    behind_gap = tick > before.seq
    first, (offset, answers) = state.changed_at, _last(before, state)
    if behind_gap:
        # The force held until the first change is unknown.
        first = 0.0
    let_go = slept > 0 and state.safety == "zero" and not any(state.force)
    start, sure = min(first, offset), not (behind_gap and slept)
    if offset - start <= SAME:
        start = offset  # delay less age is rounded
    left = impulse - held * start  # from the first change onwards
    if start >= 1.0:
        # The previous force, then at an unknown instant of the overrun the last one: the device
        # released the force itself, or the force of `next_tick` waited a tick.
        part = (left - last * slept) / (held - last) if abs(held - last) > same else 0.0
        if not slept or -SAME <= part <= slept + SAME:
            return [
                (
                    1.0 + min(max(part, 0.0), float(slept)),
                    last,
                    -1 if let_go else answers,
                )
            ], sure
    if let_go or start >= 1.0:
        # An unknown force for an unknown time.
        until, told, sure = float(covered), (-1, -1), False
    elif start < offset:
        until, told = (
            offset,
            (
                answers - 1
                if 0 <= before.force_seq < answers - 1 and not behind_gap
                else -1,
                answers,
            ),
        )
    elif state.force_seq < tick:
        # A late answer, lowered by the guard at the end of the tick.
        until, told = 1.0, (answers, -1)
    else:
        return [(offset, last, answers)], sure
    between = (left - last * (covered - until)) / (until - start)
    if abs(between - last) * (until - start) <= same:
        between = last
    return [(start, between, told[0]), (until, last, told[1])], sure
