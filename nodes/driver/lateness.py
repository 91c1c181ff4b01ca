"""Lateness in real time: which ticks are lost, and how long an answer is awaited.

A force that comes too late must not reach the device: by then the device may have let go of the
force before, which must not return without a ramp.
"""

from __future__ import annotations

from nodes.compiled.rules import rule
from nodes.driver.motion import act
from nodes.driver.notes import HELD_UP, REFUSED_FIRST
from nodes.driver.safety import REGAIN, STALE, let_go
from nodes.driver.state import ACTIVE, DAMPING, FAULT, RAMP, DriverState, note, seldom

# successive unanswered ticks after which a tick waits one period more, twice as many for two
BEHIND = 3
MAX_BEHIND = 64  # largest count of such ticks; each answer in time halves the count


@rule
def drop_waiting(s: DriverState) -> None:
    """Drop the force that waits for the next deadline; what acts remains."""
    s.has_following = 0
    for i in range(3):
        s.force[i] = s.handed[i]


@rule
def lost(s: DriverState, seq: int, late: float) -> None:
    """Skip ticks that are over: they can only be counted. The device may let go meanwhile."""
    ticks = min(int(late / s.period), s.until - seq)
    s.overruns += ticks
    s.lateness = late
    acted = min(max(s.device_hold_ticks - (seq - s.written), 0.0), float(ticks))
    for i in range(3):
        s.mean[i] = acted / ticks * s.handed[i]
    act(s, ticks)
    held = s.handed[0] != 0.0 or s.handed[1] != 0.0 or s.handed[2] != 0.0
    s.seq = seq + ticks
    if held and s.seq - s.written >= s.device_hold_ticks:
        s.has_following = 0
        let_go(s, s.seq, s.written + s.device_hold_ticks)
        note(s, HELD_UP, s.seq, -1, float(s.written))
        return
    if not held and s.safety == RAMP:
        # Nothing is felt meanwhile: it costs the ramp, and what waits has the share from before.
        s.regained = max(s.regained - REGAIN * ticks, 0.0)
        drop_waiting(s)
    elif s.has_following != 0 and s.seq - s.force_seq > s.max_age:
        drop_waiting(s)  # the force for the next deadline is too old by now


@rule
def patience(s: DriverState, deadline: float, following: float) -> float:
    """Return how long a tick waits for its answer [s]: longer after unanswered ticks.

    The coupling is behind then; another state would only wait there and make the next answer late
    as well. So a loop that is too fast for its machine runs as fast as it is answered, and loses
    the excess ticks. It waits no longer than the largest age of a force, and never past the
    watchdog or the time at which the device lets go.
    """
    more = min(s.unanswered // BEHIND, s.max_age)
    # Under ``next_tick`` an answer has a whole tick, and its force must take effect at a deadline.
    if more == 0 or s.next_tick != 0 or s.safety == DAMPING or s.safety == FAULT:
        return following
    last = following + more * s.period
    if s.safety == ACTIVE or s.safety == RAMP:
        ends = min(float(s.since + s.watchdog), s.written + s.device_hold_ticks)
        last = min(last, deadline + (ends - s.seq) * s.period)
    return following if following > last else last


@rule
def begin_waiting(s: DriverState, deadline: float) -> None:
    """Reset the counts of a tick, and decide once how long its answer is waited for.

    Whatever a tick decides stands in the state: the tick may be left for a message that the port
    cannot judge, and entered again after its first answer has changed the safety.
    """
    s.age = max(s.seq - s.force_seq, 0) if s.force_seq >= 0 else 0
    # A late answer is waited for, and the next tick sampled late: sampled on time, it would use
    # the processor that this answer needs, and be answered late itself. Not so when nothing came.
    s.patient = s.heard
    s.heard = 0
    s.answered = 0
    s.split, s.changed_at = 0.0, 1.0
    for i in range(3):
        s.mean[i] = s.handed[i] if s.next_tick != 0 else 0.0
    s.waits_until = patience(s, deadline, deadline + s.period)


@rule
def note_answered(s: DriverState) -> None:
    """Count ticks in a row without their answer, from which `patience` follows."""
    if s.answered == 0:
        # Only who is heard is behind: in a silence nobody is waited for, and every tick is sampled.
        s.unanswered = min(s.unanswered + s.heard, MAX_BEHIND)
    elif s.arrival < s.epoch + s.seq * s.period + s.period:
        # On time again; an answer that had to be waited for leaves the patience as it is.
        s.unanswered //= 2


@rule
def in_time(s: DriverState, now: float, answers: int) -> bool:
    """Return whether a force may still be written, or the driver was held up too long.

    Meanwhile the device may have let go of the previous force, which must not return without a
    ramp, and an answer may have become too old. `answers` is the tick of that answer, or -1 for the
    driver's own force.
    """
    held = s.handed[0] != 0.0 or s.handed[1] != 0.0 or s.handed[2] != 0.0
    is_late = held and now >= s.epoch + (s.written + s.device_hold_ticks) * s.period
    if answers >= 0 and now >= s.epoch + (answers + s.max_age + 1) * s.period:
        is_late = True
        s.refused_for[STALE] += 1
        if seldom(s.refused_for[STALE]):
            age = (now - s.epoch) / s.period - answers
            note(
                s,
                REFUSED_FIRST + STALE,
                s.seq,
                -1,
                float(s.refused_for[STALE]),
                age,
                float(s.max_age),
            )
    if is_late:
        for i in range(3):
            s.force[i] = s.handed[i]
    return not is_late
