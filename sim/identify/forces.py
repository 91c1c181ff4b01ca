"""What a driver handed to its device and when, rebuilt from its states: for identification, and for replays.

A state tells of the tick before it: where in it the force changed first (`changed_at`) and last
(`delay − age`), the last force, and the mean of all that was on the device since the position
before. So one force besides the last can be told: that of an earlier answer, or the answer's own,
which the guard lowered at the end of the tick. Where there is none, the mean tells when the device
let go by itself, or when the last force came, in ticks that the driver slept through.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from messages.types import DeviceState
from sim.arrays import Array, WholeArray

SAME = 1e-9  # forces closer than this part of the largest are one force: a mean is rounded


@dataclass(frozen=True)
class HandedOver:
    """The forces of one axis, in turn."""

    at: Array  # when each was handed over [ticks], rising, shape (M,)
    force: Array  # the force, which holds until the next [N], shape (M,)
    # the tick that each answers; −1 for the driver's own, and where nobody tells, shape (M,)
    answers: WholeArray
    unsure: WholeArray  # ticks of which only the mean is known, shape (U,)

    @property
    def delay(self) -> Array:
        """Ticks from each tick that was answered, however late, to its force, shape (D,)."""
        answered = self.answers >= 0
        return self.at[answered] - self.answers[answered]


def handed_over(states: Sequence[DeviceState], axis: int) -> HandedOver:
    """Rebuild the forces of an axis; where a driver tells no means (PROTOCOL.md lets it), the last force of each tick alone."""
    strongest = max(abs(state.force[axis]) for state in states)
    has_means = not strongest or any(state.mean_force[axis] for state in states)
    same, first = SAME * strongest, states[0]
    told = [
        (first.seq - 1.0, first.mean_force[axis], -1),
        (float(first.seq), first.force[axis], -1),
    ]
    unsure: list[int] = []
    since = first.seq  # tick of the newest position: in a fault there is none, and the mean goes on
    for before, state in pairwise(states):
        # What the driver slept through is in the mean; ticks that only the recording lacks had
        # states of their own.
        covered = min(max(1 + state.overruns - before.overruns, 1), state.seq - before.seq)
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
    """When the last force of a tick came [ticks since it began], and the tick it answers; −1 for the driver's own."""
    if state.force_seq != before.force_seq and state.delay >= state.age:
        return min(state.delay - state.age, 1.0), state.force_seq
    return 1.0, -1


def _changes(
    before: DeviceState, state: DeviceState, axis: int, covered: int, impulse: float, same: float
) -> tuple[list[tuple[float, float, int]], bool]:
    """Tell which forces came in the last tick before a state, and in those slept through after it; and whether that is sure.

    Each force with when it came [ticks since that tick began], and the tick it answers; together
    they make `impulse` [N ticks].
    """
    tick, slept = state.seq - covered, covered - 1
    held, last = before.force[axis], state.force[axis]
    behind_gap = tick > before.seq
    first, (offset, answers) = state.changed_at, _last(before, state)
    if behind_gap:
        # Nobody tells what was held until the first change.
        first = 0.0
    let_go = slept > 0 and state.safety == "zero" and not any(state.force)
    start, sure = min(first, offset), not (behind_gap and slept)
    if offset - start <= SAME:
        start = offset  # delay less age is rounded
    left = impulse - held * start  # of what came at the first change and later
    if start >= 1.0:
        # The force before, and somewhere in what was slept through the last one: the device's own
        # hold let go, or the force of `next_tick` had to wait for a tick.
        part = (left - last * slept) / (held - last) if abs(held - last) > same else 0.0
        if not slept or -SAME <= part <= slept + SAME:
            return [
                (1.0 + min(max(part, 0.0), float(slept)), last, -1 if let_go else answers)
            ], sure
    if let_go or start >= 1.0:
        # A force that nobody tells, for a time that nobody tells.
        until, told, sure = float(covered), (-1, -1), False
    elif start < offset:
        until, told = (
            offset,
            (
                answers - 1 if 0 <= before.force_seq < answers - 1 and not behind_gap else -1,
                answers,
            ),
        )
    elif state.force_seq < tick:
        # An answer that came late, lowered by the guard at the end of the tick.
        until, told = 1.0, (answers, -1)
    else:
        return [(offset, last, answers)], sure
    between = (left - last * (covered - until)) / (until - start)
    if abs(between - last) * (until - start) <= same:
        between = last
    return [(start, between, told[0]), (until, last, told[1])], sure
