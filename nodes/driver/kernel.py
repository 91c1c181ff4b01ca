"""Compiled tick of the driver: nodes/driver/tick.py and its rules, with C functions."""

from __future__ import annotations

from messages.types import Force
from nodes.compiled.kernels import hop, machine
from nodes.compiled.kernels.encode import make_write
from nodes.compiled.kernels.hop import (
    called,
    enqueue,
    flush,
    has_message,
    monotonic,
    out_at,
    receive,
    send_hop,
)
from nodes.compiled.kernels.machine import (
    compilable,
    copy16,
    reals_at,
    record_at,
    wholes_at,
)
from nodes.compiled.kernels.scan import make_scan
from nodes.compiled.kernels.sources import record_of, register_rules
from nodes.compiled.message_fields import fields_of, slots
from nodes.driver.calls import JUMPED
from nodes.driver.state import BETWEEN, PUBLISHED, DriverState
from nodes.driver.tick import GOT, NONE, UNREAD, Port, make_ticks

register_rules()
_look = record_at(record_of(DriverState))
_scan = make_scan(Force)
_write_state = make_write(PUBLISHED)
_SEQ, _FORCE, _NORMAL, _CREDIT = slots(
    fields_of(Force), "seq", "force", "normal", "credit"
)
_TIMER_ABSTIME = 1
# shortest wait of ZeroMQ in `Subscription.receive_soon` [s]
_SOON = 1e-3


@compilable
def _clock(s: DriverState) -> float:
    return monotonic(s)


@compilable
def _sleep_until(s: DriverState, deadline: float) -> float:
    now = monotonic(s)
    if now < deadline:
        until = wholes_at(s.time, 2)
        seconds = int(deadline)
        until[0], until[1] = seconds, int((deadline - seconds) * 1e9) + 1
        machine.call_sleep(
            s.clock_nanosleep, (hop.CLOCK_MONOTONIC, _TIMER_ABSTIME, s.time, 0)
        )
        now = monotonic(s)
    return now


@compilable
def _read(s: DriverState, seq: int) -> bool:
    room = reals_at(s.device_room, 6)
    room[3] = room[4] = room[5] = 0.0
    status = machine.call_read(s.device_read, (s.device_context, seq, s.device_room))
    if status < 0:
        return False
    if status == JUMPED:
        s.jumped = 1
    for i in range(3):
        s.place[i] = room[i]
        s.target[i] = room[3 + i]
    return True


@compilable
def _write(s: DriverState, seq: int, offset: float) -> bool:
    room = reals_at(s.device_room, 6)
    for i in range(3):
        room[i] = s.handed[i]
    return bool(
        machine.call_write(
            s.device_write, (s.device_context, s.device_room, seq, offset)
        )
        >= 0
    )


@compilable
def _publish(s: DriverState, seq: int, stamp: float) -> None:  # noqa: ARG001  # the port's
    s.stamp = stamp
    s.text, s.text_size = s.texts[s.safety], s.text_sizes[s.safety]
    at = out_at(s)
    size = _write_state(s, at) - at
    s.sent, s.sent_size = at, size
    s.states_sent += 1
    # before sending: under FIFO the whole chain may run before the call returns
    s.sampled = monotonic(s)
    send_hop(s, at, size)


@compilable
def _await(s: DriverState, deadline: float) -> bool:
    """Wait for a message until an absolute time, to the microsecond, as `receive_until` does."""
    while True:
        if has_message(s, s.inbox):
            return True
        remaining = deadline - monotonic(s)
        if remaining <= 0.0:
            return False
        left = wholes_at(s.time, 2)
        seconds = int(remaining)
        left[0], left[1] = seconds, int((remaining - seconds) * 1e9)
        machine.call_poll(s.ppoll, (s.poll, 1, s.time, 0))


@compilable
def _receive(s: DriverState, until: float) -> int:
    flags = 0
    if s.realtime != 0:
        # wait a little for a late answer, as ZeroMQ's own time-outs do
        if not _await(s, max(until, monotonic(s) + _SOON) if s.patient != 0 else until):
            return NONE
        flags = hop.DONTWAIT
    is_whole = receive(s, flags)
    s.arrival = monotonic(s)
    if s.frames == 0:
        return NONE
    if not is_whole or not _scan(
        s.payload, s.payload + s.payload_size, s.reals, s.wholes
    ):
        return UNREAD
    s.frames = 0
    s.taken += 1
    s.got_seq = s.wholes[_SEQ]
    for i in range(3):
        s.got[i] = s.reals[_FORCE + i]
        s.got_normal[i] = s.reals[_NORMAL + i]
    s.got_credit = s.reals[_CREDIT]
    return GOT


@compilable
def _aside(s: DriverState) -> None:
    if enqueue(s, s.sent_size):
        flush(s)


@compilable
def _called(s: DriverState) -> bool:
    return bool(called(s) or s.attention != 0)


_lockstep, _realtime = make_ticks(
    Port(_clock, _sleep_until, _read, _write, _publish, _receive, _aside, _called),
    compilable,
)


@compilable
def _settle(s: DriverState) -> None:
    """Send collected messages; move the message of a pending tick out of the way."""
    flush(s)
    if s.aside != 0 and s.phase != BETWEEN and s.sent != s.held:
        for at in range(0, s.sent_size, 16):
            copy16(s.held + at, s.sent + at)
        s.sent = s.held


@compilable
def ticks(address: int) -> int:
    """Tick until the driver is needed. Return why."""
    s = _look(address)
    why = _realtime(s) if s.realtime != 0 else _lockstep(s)
    _settle(s)
    return why
