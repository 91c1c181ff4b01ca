"""The tick of a driver, in real time and lockstep: read, publish, await the force, apply.

One source for the interpreter and the compiled tick. They differ in the `Port`: how time passes,
how the device is called, and how messages arrive (pyzmq and msgspec, or ZeroMQ by address and the
scanner). If a port cannot do something, `ticks` returns a reason; the caller handles it and calls
again, and the tick continues.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from nodes.compiled.rules import rule
from nodes.driver.motion import act, sample, split
from nodes.driver.notes import HELD_UP, REFUSED_FIRST
from nodes.driver.passivity import count_step
from nodes.driver.response_times import note_response
from nodes.driver.safety import (
    STALE,
    admit,
    command,
    let_go,
    missed,
    rebase,
    watch_position,
    watch_swings,
)
from nodes.driver.state import (
    ACTIVE,
    BETWEEN,
    DAMPING,
    FAULT,
    RAMP,
    WAITING,
    DriverState,
    note,
    seldom,
)

# outcome of a wait for a message: valid; none in time; refused; the port cannot judge it
GOT, NONE, REFUSED, UNREAD = range(4)
# why `ticks` ended: nothing unusual; no answer for a while; a device call failed
GO_ON, SILENT, BROKEN = range(3)

# successive unanswered ticks after which a tick waits one period more, twice as many for two
BEHIND = 3
MAX_BEHIND = 64  # largest count of such ticks; each answer in time halves the count


class Port(NamedTuple):
    """How a tick accesses the world; every function has the state as first argument."""

    clock: Callable[[Any], float]  # returns the time [s]
    sleep_until: Callable[[Any, float], float]  # returns the time of waking
    # sets `place` and `jumped`; this and the next return whether the device did it
    read: Callable[[Any, int], bool]
    write: Callable[[Any, int, float], bool]  # hands over `handed`
    publish: Callable[[Any, int, float], None]  # publishes the state of a tick
    # waits for a message until a time, or in lockstep for a while
    receive: Callable[[Any, float], int]
    # sends the listeners' messages when no node waits for one any more
    aside: Callable[[Any], None]
    called: Callable[[Any], bool]  # returns whether something waits between two ticks


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
    elif s.has_following != 0 and s.seq - s.force_seq > s.max_age:
        s.has_following = 0  # the force for the next deadline is too old by now
        for i in range(3):
            s.force[i] = s.handed[i]


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


@rule
def take_sample(s: DriverState, seq: int, stamp: float) -> None:
    """Use the position read as the tick's sample, and update energy, guard and safety."""
    if watch_position(s, seq):
        if s.jumped != 0:
            rebase(s, seq)
        stepped = sample(s, stamp)
        s.jumped = 0
        if s.guard_on != 0 and stepped:
            count_step(s)
        if s.stop_after != 0:
            watch_swings(s, seq)
    s.asked = seq


@rule
def decide(s: DriverState, seq: int) -> None:
    """Apply the answer of a tick in lockstep: set `force`, `handed` and the tick's `mean`."""
    command(s, seq, float(s.next_tick))
    for i in range(3):
        s.mean[i] = s.handed[i] if s.next_tick != 0 else s.force[i]
        s.handed[i] = s.force[i]


@rule
def close(s: DriverState) -> None:
    """End a tick."""
    act(s, 1)
    s.ticks += 1
    s.seq += 1
    s.phase = BETWEEN


# Long: one compiled function, because a call would cost more than it saves.
def make_ticks(  # noqa: C901, PLR0915
    port: Port, made: Callable[[Any], Any] = lambda function: function
) -> tuple[Callable[[Any], int], Callable[[Any], int]]:
    """Return the ticks of a port in lockstep and real time; they run until a caller is needed.

    They return why they ended.
    """
    clock, sleep_until, read, write, publish, receive, aside, called = port

    @made
    def begin(s: DriverState, seq: int, stamp: float) -> bool:
        if s.position_ready == 0 and not read(s, seq):
            return False
        s.position_ready = 0
        take_sample(s, seq, stamp)
        publish(s, seq, stamp)
        s.phase = WAITING
        return True

    @made
    def hand_over(s: DriverState, force: Any, seq: int, offset: float) -> None:
        for i in range(3):
            s.handed[i] = force[i]
        s.written = seq
        if not write(s, seq, offset):
            s.failed = 1

    @made
    def hand_over_in_time(
        s: DriverState, force: Any, seq: int, offset: float, answers: int
    ) -> bool:
        # The last check of the clock before the device is called: every wait may have held the
        # driver up.
        if not in_time(s, clock(s), answers):
            return False
        hand_over(s, force, seq, offset)
        return True

    @made
    def lockstep_tick(s: DriverState) -> int:
        seq = s.seq
        if s.phase == BETWEEN and not begin(s, seq, seq * s.period):
            return BROKEN
        while True:
            got = s.pending_result - 1 if s.pending_result != 0 else receive(s, 0.0)
            s.pending_result = 0
            if got == UNREAD:
                return UNREAD
            if got == NONE:
                return SILENT
            # only the tick's own answer counts
            if got == GOT and s.got_seq == seq and admit(s, seq):
                break
            s.skipped += 1
        s.response = s.arrival - s.sampled
        note_response(s, s.response)
        decide(s, seq)
        hand_over(s, s.force, seq + s.next_tick, 0.0)
        s.delay = s.changed_at = float(s.next_tick)
        close(s)
        return GO_ON

    # Long: one compiled function, because a call would cost more than it saves.
    @made
    def realtime_tick(s: DriverState) -> int:  # noqa: C901, PLR0915
        seq = s.seq
        deadline = s.epoch + seq * s.period
        following = deadline + s.period
        if s.phase == BETWEEN:
            now = deadline + s.lateness
            if s.position_ready == 0:
                now = sleep_until(s, deadline)
                if now < deadline:
                    return GO_ON
                if now - deadline >= s.period:
                    lost(s, seq, now - deadline)  # the driver itself was held up
                    return GO_ON
                s.lateness = now - deadline
                if s.has_following != 0:
                    # under ``next_tick`` hardware also gets its force at the start of the tick
                    s.has_following = 0
                    hand_over_in_time(s, s.following, seq, 0.0, s.force_seq)
            if not begin(s, seq, now + s.clock_offset):
                return BROKEN
            s.age = max(seq - s.force_seq, 0) if s.force_seq >= 0 else 0
            # Wait for an answer that is a little late, and sample the next tick late. Sampling on
            # time would steal the CPU from the late answer and delay every later one. Not so if
            # nothing came.
            s.patient, s.heard, s.answered = s.heard, 0, 0
            s.split, s.changed_at = 0.0, 1.0
            for i in range(3):
                s.mean[i] = s.handed[i] if s.next_tick != 0 else 0.0
        last = patience(s, deadline, following)
        while s.answered == 0:
            got = GOT
            if s.late_answer != 0:
                s.late_answer, s.arrival = 0, s.late_answer_at
            else:
                got = s.pending_result - 1 if s.pending_result != 0 else receive(s, last)
                s.pending_result = 0
                if got == NONE:
                    break
                s.heard = 1
                if got == UNREAD:
                    return UNREAD
                if got == GOT and s.arrival >= last:
                    # a flooded topic must not delay the next tick
                    s.late_answer, s.late_answer_at = 1, s.arrival
                    break
            if got == REFUSED or not admit(s, seq):
                s.skipped += 1
                if s.arrival >= last:
                    break
                continue
            s.answered = 1 if s.got_seq == seq else 0
            s.age = seq - s.got_seq
            offset = min(max((s.arrival - deadline) / s.period, 0.0), 1.0)
            command(s, seq, 1.0 if s.next_tick != 0 else offset)
            if s.next_tick != 0:
                s.has_following = 1
                for i in range(3):
                    s.following[i] = s.force[i]
                s.delay = 1.0 + s.age
            else:
                split(s, offset)
                if hand_over_in_time(s, s.force, seq, offset, s.got_seq):
                    s.changed_at = min(s.changed_at, offset)
                s.delay = max(offset, (s.arrival - deadline) / s.period) + s.age
            if s.answered != 0:
                s.response = s.arrival - s.sampled
                note_response(s, s.response)
        s.oldest_age = max(s.oldest_age, s.age)
        if s.next_tick == 0:
            split(s, 1.0)
        if s.answered == 0:
            # Only a peer that is heard is behind: in a silence nobody is waited for, and every tick
            # is sampled.
            s.unanswered = min(s.unanswered + s.heard, MAX_BEHIND)
        elif s.arrival < following:
            # on time again; an answer that had to be waited for leaves the count as it is
            s.unanswered //= 2
        if s.answered == 0:
            # in a fault there is no position that could have been answered
            s.missed += 1 if s.safety != FAULT else 0
            s.response = 0.0
            is_written = False
            if missed(s, seq):
                s.has_following = 0
                is_written = hand_over_in_time(s, s.force, seq + 1, 0.0, -1)
            if (
                not is_written
                and s.has_following == 0
                and seq + 1 - s.written >= s.device_hold_ticks
            ):
                let_go(s, seq, s.written + s.device_hold_ticks)
        close(s)
        return GO_ON

    def ticks_of(tick: Callable[[Any], int]) -> Callable[[Any], int]:
        @made
        def ticks(s: DriverState) -> int:
            done = 0
            while done < s.most and s.seq < s.until:
                before = s.ticks
                why = tick(s)
                if why != GO_ON:
                    return why
                if s.ticks != before:
                    done += 1
                    aside(s)
                if called(s) or s.notes_count != 0:
                    break
                if s.failed != 0:
                    return BROKEN
            return GO_ON

        done: Callable[[Any], int] = ticks
        return done

    return ticks_of(lockstep_tick), ticks_of(realtime_tick)
