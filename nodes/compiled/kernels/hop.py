"""Receiving and sending as messages/transport/sockets.py does, by socket address."""

from __future__ import annotations

from numba.extending import overload

from messages.codec import MAX_PAYLOAD
from nodes.compiled.kernels.machine import (
    byte,
    call_clock,
    call_option,
    call_pass,
    call_yield,
    compilable,
    wholes_at,
)
from nodes.compiled.layout import LONGEST_IN, LONGEST_OUT, LONGEST_TOPIC, LoopState
from nodes.compiled.memory import monotonic as monotonic

SNDMORE = 2
DONTWAIT = 1
CLOCK_MONOTONIC = 1
_RCVMORE, _EVENTS, _POLLIN = 13, 15, 1

_MAX_PAYLOAD = MAX_PAYLOAD
_ROOM, _ROOM_IN, _ROOM_TOPIC = LONGEST_OUT, LONGEST_IN, LONGEST_TOPIC


@compilable
def _read_clock(s: LoopState) -> float:
    call_clock(s.clock_gettime, (CLOCK_MONOTONIC, s.time))
    now = wholes_at(s.time, 2)
    return float(now[0] + now[1] * 1e-9)


overload(monotonic)(lambda s: lambda s: _read_clock(s))  # noqa: ARG005


@compilable
def receive(s: LoopState, flags: int) -> bool:
    """Receive one message of the expected topic; another one stays in the buffers."""
    s.frames = 0
    size = call_pass(s.zmq_recv, (s.inbox, s.frame, _ROOM_TOPIC, flags))
    if size < 0:
        return False
    s.frames = 1
    s.frame_size = size
    if size != s.expected_size:
        return False
    for m in range(size):
        if byte(s.frame + m) != byte(s.expected + m):
            return False
    more = wholes_at(s.events, 1)
    more[0] = 0
    call_option(s.zmq_getsockopt, (s.inbox, _RCVMORE, s.events, s.events_size))
    if more[0] == 0:
        # a message of one frame: the next frame belongs to another message
        s.frames, s.payload_size = 2, 0
        return False
    size = call_pass(s.zmq_recv, (s.inbox, s.payload, _ROOM_IN, flags))
    if size < 0:
        return False
    s.frames = 2
    s.payload_size = size
    return bool(size <= _MAX_PAYLOAD)


@compilable
def has_message(s: LoopState, socket: int) -> bool:
    """Return whether a message waits at a socket."""
    events = wholes_at(s.events, 1)
    events[0] = 0
    call_option(s.zmq_getsockopt, (socket, _EVENTS, s.events, s.events_size))
    return bool(events[0] & _POLLIN != 0)


@compilable
def out_at(s: LoopState) -> int:
    """Return the address for the next message: the batch for listeners, if there is one."""
    return int(s.held + s.held_count * _ROOM if s.aside != 0 else s.out)


@compilable
def send_hop(s: LoopState, at: int, size: int) -> None:
    """Send a message to the next hop."""
    call_pass(s.zmq_send, (s.hop, s.topic, s.topic_size, SNDMORE))
    call_pass(s.zmq_send, (s.hop, at, size, 0))


@compilable
def flush(s: LoopState) -> None:
    """Send the batch for the listeners."""
    sizes = wholes_at(s.held_sizes, s.batch)
    for k in range(s.held_count):
        call_pass(s.zmq_send, (s.aside, s.topic, s.topic_size, SNDMORE))
        call_pass(s.zmq_send, (s.aside, s.held + k * _ROOM, sizes[k], 0))
    s.held_count = 0


@compilable
def enqueue(s: LoopState, size: int) -> bool:
    """Queue the message at `out_at` for the listeners. Return whether the batch is full."""
    if s.aside == 0:
        return False
    wholes_at(s.held_sizes, s.batch)[s.held_count] = size
    s.held_count += 1
    return bool(s.held_count >= s.batch)


@compilable
def answer(s: LoopState, at: int, size: int) -> None:
    """Send a message to the next hop, then to the listeners."""
    send_hop(s, at, size)
    if enqueue(s, size):
        # Under FIFO the I/O thread, no more urgent than this one, still has the message for the
        # hop.
        call_yield(s.sched_yield, (0,))
        flush(s)
    s.sent, s.sent_size = at, size


@compilable
def called(s: LoopState) -> bool:
    """Send another thread's message, once per batch. Return whether listeners sent something."""
    s.unlooked += 1
    if s.unlooked < s.batch:
        return False
    s.unlooked = 0
    if s.outgoing != 0:
        to = s.aside if s.aside != 0 else s.hop
        call_pass(s.zmq_send, (to, s.outgoing_topic, s.outgoing_topic_size, SNDMORE))
        call_pass(s.zmq_send, (to, s.outgoing_payload, s.outgoing_size, 0))
        s.outgoing_sent += 1
        s.outgoing = 0
    if has_message(s, s.hop) or (s.aside != 0 and has_message(s, s.aside)):
        s.upstream = 1
        return True
    return False
