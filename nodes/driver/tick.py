"""The tick of a driver, in real time and lockstep: read, publish, await the force, apply.

One source for the interpreter and the compiled tick. They differ in the `Port`: how time passes,
how the device is called, and how messages arrive (pyzmq and msgspec, or ZeroMQ by address and the
scanner). If a port cannot do something, `ticks` returns a reason; the caller handles it and calls
again, and the tick continues.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

from nodes.compiled.rules import Made, rule
from nodes.driver.lateness import begin_waiting, in_time, lost, note_answered
from nodes.driver.motion import act, sample, split
from nodes.driver.passivity import count_step
from nodes.driver.response_times import note_response
from nodes.driver.safety import admit, command, let_go, missed, rebase, watch_position
from nodes.driver.state import BETWEEN, FAULT, WAITING, DriverState
from nodes.driver.swings import watch_swings

# outcome of a wait for a message: valid; none in time; refused; the port cannot judge it
# the last two end the wait
GOT, REFUSED, NONE, UNREAD = range(4)
READY = -1  # a sample is published and awaits its answer
# why `ticks` ended: nothing unusual; no answer for a while; a device call failed
GO_ON, SILENT, BROKEN = range(3)


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
    s.guard_owed = s.guard_energy[0] + s.guard_energy[1] + s.guard_energy[2]


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


TickFunction: TypeAlias = Callable[[Any], int]


class TickCalls(NamedTuple):
    """What both ticks do with a port."""

    # reads and publishes a sample; False if it failed
    begin: Callable[[Any, int, float], bool]
    hand_over: Callable[[Any, Any, int, float], None]  # gives a force to the device
    # the same, where the driver was not held up meanwhile; whether it did
    hand_over_in_time: Callable[[Any, Any, int, float, int], bool]


def make_ticks(
    port: Port, made: Made = lambda function: function
) -> tuple[TickFunction, TickFunction]:
    """Return the ticks of a port, in lockstep and in real time.

    Both go on until something waits, and return why they ended.
    """
    calls = _make_calls(port, made)
    lockstep = _make_lockstep_tick(port, calls, made)
    realtime = _make_realtime_tick(port, calls, made)
    return _repeated(lockstep, port, made), _repeated(realtime, port, made)


def _make_calls(port: Port, made: Made) -> TickCalls:
    clock, read, write, publish = port.clock, port.read, port.write, port.publish

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
        # The last look at the clock before the device is called: the driver may be held up after
        # every wait.
        if not in_time(s, clock(s), answers):
            return False
        hand_over(s, force, seq, offset)
        return True

    return TickCalls(begin, hand_over, hand_over_in_time)


def _make_lockstep_tick(port: Port, calls: TickCalls, made: Made) -> TickFunction:
    receive = port.receive
    begin, hand_over, _ = calls

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
            # Only the tick's own answer counts.
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

    tick: TickFunction = lockstep_tick
    return tick


def _make_realtime_tick(port: Port, calls: TickCalls, made: Made) -> TickFunction:
    start_sample = _make_start(port, calls, made)
    take_answers = _make_answers(port, calls, made)
    hand_over_in_time = calls.hand_over_in_time

    @made
    def finish(s: DriverState) -> None:
        seq = s.seq
        s.oldest_age = max(s.oldest_age, s.age)
        if s.next_tick == 0:
            split(s, 1.0)
        note_answered(s)
        if s.answered == 0:
            # In a fault there is no position that could have been answered.
            s.missed += 1 if s.safety != FAULT else 0
            s.response = 0.0
            is_written = False
            if missed(s, seq):
                s.has_following = 0
                is_written = hand_over_in_time(s, s.force, seq + 1, 0.0, -1)
            lets_go = seq + 1 - s.written >= s.device_hold_ticks
            if not is_written and s.has_following == 0 and lets_go:
                let_go(s, seq, s.written + s.device_hold_ticks)
        close(s)

    @made
    def realtime_tick(s: DriverState) -> int:
        if s.phase == BETWEEN:
            told = start_sample(s)
            if told != READY:
                return int(told)
        if take_answers(s) == UNREAD:
            return UNREAD
        finish(s)
        return GO_ON

    tick: TickFunction = realtime_tick
    return tick


def _make_start(port: Port, calls: TickCalls, made: Made) -> TickFunction:
    sleep_until = port.sleep_until
    begin, _, hand_over_in_time = calls

    @made
    def start_sample(s: DriverState) -> int:
        """Sleep until the deadline, write the force that waits for it, and publish the sample."""
        seq = s.seq
        deadline = s.epoch + seq * s.period
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
                # Under ``next_tick`` hardware, too, gets its force at the start of the tick.
                s.has_following = 0
                hand_over_in_time(s, s.following, seq, 0.0, s.force_seq)
        if not begin(s, seq, now + s.clock_offset):
            return BROKEN
        begin_waiting(s, deadline)
        return READY

    start: TickFunction = start_sample
    return start


def _make_answers(port: Port, calls: TickCalls, made: Made) -> TickFunction:
    receive, hand_over_in_time = port.receive, calls.hand_over_in_time

    @made
    def next_answer(s: DriverState) -> int:
        """Return what came before the wait is over; what came later is kept for the next tick."""
        if s.late_answer != 0:
            s.late_answer = 0
            s.arrival = s.late_answer_at
            return GOT
        got = (
            s.pending_result - 1 if s.pending_result != 0 else receive(s, s.waits_until)
        )
        s.pending_result = 0
        if got == NONE:
            return NONE
        s.heard = 1
        if got == GOT and s.arrival >= s.waits_until:
            # A flooded topic must not delay the next tick.
            s.late_answer = 1
            s.late_answer_at = s.arrival
            return NONE
        return int(got)

    @made
    def use(s: DriverState) -> None:
        """Use a force that was admitted: now, or at the next deadline under ``next_tick``."""
        seq = s.seq
        after = (s.arrival - (s.epoch + seq * s.period)) / s.period
        s.answered = 1 if s.got_seq == seq else 0
        s.age = seq - s.got_seq
        offset = min(max(after, 0.0), 1.0)
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
            s.delay = max(offset, after) + s.age
        if s.answered != 0:
            s.response = s.arrival - s.sampled
            note_response(s, s.response)

    @made
    def take_answers(s: DriverState) -> int:
        """Use the forces that arrive in time, up to the one that answers this tick."""
        while s.answered == 0:
            got = next_answer(s)
            if got >= NONE:
                return int(got)
            if got == GOT and admit(s, s.seq):
                use(s)
                continue
            s.skipped += 1
            if s.arrival >= s.waits_until:
                return NONE
        return GOT

    take: TickFunction = take_answers
    return take


def _repeated(tick: TickFunction, port: Port, made: Made) -> TickFunction:
    aside, called = port.aside, port.called

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

    repeated: TickFunction = ticks
    return repeated
