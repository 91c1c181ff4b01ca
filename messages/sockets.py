"""ZeroMQ sockets as the loop needs them: one bound publisher per node, listeners that connect, two frames per message.

The choices are measured ones: blocking receive rather than a poller, default high-water marks on loop sockets, no
CONFLATE (it corrupts multipart messages), and a publisher that sees its subscribers come (XPUB), so that a loop starts when
everybody listens instead of after a sleep.
"""

from __future__ import annotations

import os
import select
import time
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import zmq

from messages.endpoints import bind, connect, remove_ipc

if TYPE_CHECKING:
    from messages.gate import Gate

    Context = zmq.Context[zmq.Socket[bytes]]
    Socket = zmq.Socket[bytes]

SEND_QUEUE = 4096
"""Messages queued for one stalled listener before its newest ones are dropped: 8 s at 500 Hz, about 1 MB."""

# pyzmq's attributes of the same names cost three times as much.
_MORE = int(zmq.RCVMORE)
_EVENTS = int(zmq.EVENTS)

IO_ABOVE = 5
"""By how much an I/O thread's SCHED_FIFO priority is above its node's: what is sent leaves before the sender goes on."""


def new_context(aside: bool = False) -> Context:
    """Make a context whose sockets never delay its end.

    The I/O thread inherits the affinity of the calling thread, and under SCHED_FIFO runs above it: set both first.

    Parameters
    ----------
    aside : bool
        Whether to have a second I/O thread, for listeners: see `Publisher` and `move_aside`.

    Returns
    -------
    zmq.Context
        With linger 0.
    """
    context: Context = zmq.Context(io_threads=2 if aside else 1)
    context.linger = 0
    if os.sched_getscheduler(0) == os.SCHED_FIFO:
        context.set(zmq.THREAD_SCHED_POLICY, os.SCHED_FIFO)
        context.set(zmq.THREAD_PRIORITY, os.sched_getparam(0).sched_priority + IO_ABOVE)
    return context


def move_aside() -> None:
    """Take the second I/O thread off the chain's core and out of its priority.

    It serves the listeners; nothing in the loop waits for it. Call it when the context's first socket exists.
    """
    for path in Path("/proc/self/task").iterdir():
        # libzmq names its threads by their number.
        if (path / "comm").read_text(encoding="ascii", errors="replace").strip().endswith("IO/1"):
            thread = int(path.name)
            others = set(range(os.cpu_count() or 1)) - os.sched_getaffinity(0)
            os.sched_setscheduler(thread, os.SCHED_OTHER, os.sched_param(0))
            if others:
                os.sched_setaffinity(thread, others)


class Publisher:
    """A node's one publishing socket.

    The next hop of the loop and the listeners connect to different endpoints of it, and each endpoint has an I/O thread of its
    own: what goes to loggers is carried by another core than the loop's.

    Parameters
    ----------
    context : zmq.Context
        Context of the process.
    endpoint : str
        Where to bind, see messages/endpoints.py.
    more : iterable of str
        Further endpoints, encrypted ones last.
    listen : str
        Endpoint for listeners, served by the second I/O thread of a context made with ``aside``; empty for none.

    Raises
    ------
    EndpointRefusedError, KeyRefusedError
        When an endpoint or this machine's keys cannot be used.
    """

    def __init__(self, context: Context, endpoint: str, more: Iterable[str] = (), listen: str = "") -> None:
        self._socket = context.socket(zmq.XPUB)
        self._socket.setsockopt(zmq.XPUB_VERBOSER, 1)
        self._socket.sndhwm = SEND_QUEUE
        self._endpoints = (endpoint, *more, *((listen,) if listen else ()))
        try:
            for place in self._endpoints:
                # Bit 0 is the first I/O thread, bit 1 the second.
                self._socket.setsockopt(zmq.AFFINITY, 2 if place == listen else 1)
                bind(self._socket, place)
        except ValueError:
            self._socket.close(linger=0)
            raise
        self._send = self._socket.send
        self._peers: dict[bytes, int] = {}
        self.endpoint = endpoint
        self.sent: dict[str, int] = {}

    def send(self, topic: bytes, payload: bytes) -> None:
        """Publish one message: two frames, topic and payload.

        Parameters
        ----------
        topic : bytes
            Full topic name.
        payload : bytes
            An encoded message.
        """
        self._send(topic, zmq.SNDMORE)
        self._send(payload)

    def listeners(self) -> int:
        """Count the listeners whose subscriptions have arrived.

        Returns
        -------
        int
            Live subscriptions to this publisher; every listener of a launch makes one.
        """
        while True:
            try:
                frame = self._socket.recv(zmq.NOBLOCK)
            except zmq.Again:
                return sum(self._peers.values())
            # Anything else than a subscription or its end is a peer's attempt to talk back; nobody listens.
            if frame[:1] in (b"\x00", b"\x01"):
                topic = frame[1:]
                count = self._peers.get(topic, 0) + (1 if frame[:1] == b"\x01" else -1)
                self._peers[topic] = count
                if not count:
                    del self._peers[topic]

    def watched_by(self, gate: Gate) -> None:
        """Let a gate watch who tries to connect.

        Parameters
        ----------
        gate : Gate
            The gate of the process, not yet started.
        """
        gate.watch(self._socket, "server")

    def close(self, linger_ms: int = 500) -> None:
        """Close the socket and remove its file.

        Parameters
        ----------
        linger_ms : int
            How long queued messages may take to leave [ms].
        """
        self._socket.close(linger=linger_ms)
        for place in self._endpoints:
            remove_ipc(place)


class Subscription:
    """Topics of one or several publishers, received in order.

    Parameters
    ----------
    context : zmq.Context
        Context of the process.
    endpoints : iterable of str
        Publishers to connect to, see messages/endpoints.py.
    topics : iterable of str
        Topics to take; ``""`` takes all.
    queue : int
        High-water mark; the default serves the loop, a logger takes more.

    Raises
    ------
    EndpointRefusedError, KeyRefusedError
        When an endpoint or this machine's keys cannot be used.
    """

    def __init__(self, context: Context, endpoints: Iterable[str], topics: Iterable[str], queue: int = 1000) -> None:
        self._socket = context.socket(zmq.SUB)
        self._socket.rcvhwm = queue
        self._socket.setsockopt(zmq.AFFINITY, 1)
        self._timeout_ms = -1
        self._recv = self._socket.recv
        self._get = self._socket.get
        self._fd = self._socket.FD
        try:
            for endpoint in endpoints:
                connect(self._socket, endpoint)
        except ValueError:
            self._socket.close(linger=0)
            raise
        for topic in topics:
            self._socket.subscribe(topic)

    def _rest(self, topic: bytes) -> tuple[bytes, bytes]:
        """Take the second frame. A message of one frame has none; a third frame is met as the next message's first."""
        return (topic, self._recv()) if self._get(_MORE) else (b"", b"")

    def receive(self, timeout_ms: int) -> tuple[bytes, bytes] | None:
        """Wait for the next message with blocking receive (one wake-up, no poller).

        Parameters
        ----------
        timeout_ms : int
            Longest wait [ms]; 0 does not wait.

        Returns
        -------
        tuple of bytes or None
            Topic and payload; None when the time was over, ``(b"", b"")`` for a message of one frame.
        """
        if timeout_ms != self._timeout_ms:
            self._socket.rcvtimeo = timeout_ms
            self._timeout_ms = timeout_ms
        try:
            topic = self._recv()
        except zmq.Again:
            return None
        return self._rest(topic)

    def receive_until(self, deadline: float) -> tuple[bytes, bytes] | None:
        """Wait for the next message until an absolute time, to the microsecond.

        ZeroMQ's own time-outs are whole milliseconds, too coarse above 500 Hz, so the wait is a select on the socket's
        descriptor. That is edge-triggered: the socket must have said that it has nothing before each wait.

        Parameters
        ----------
        deadline : float
            Time on the monotonic clock [s].

        Returns
        -------
        tuple of bytes or None
            As `receive`.
        """
        while not int(self._get(_EVENTS)) & zmq.POLLIN:
            remaining = deadline - time.monotonic()
            if remaining <= 0.0:
                return None
            select.select((self._fd,), (), (), remaining)
        return self._rest(self._recv())

    def watched_by(self, gate: Gate) -> None:
        """Let a gate watch who answers where this connects.

        Parameters
        ----------
        gate : Gate
            The gate of the process, not yet started.
        """
        gate.watch(self._socket, "client")

    def close(self) -> None:
        """Close the socket."""
        self._socket.close(linger=0)
