"""ZeroMQ sockets as the loop needs them: one bound publisher per node, listeners that connect, two frames per message.

The choices are measured ones: blocking receive rather than a poller, default high-water marks on loop sockets, no
CONFLATE (it corrupts multipart messages), and a publisher that sees its subscribers come (XPUB), so that a loop starts when
everybody listens instead of after a sleep.
"""

from __future__ import annotations

import os
import select
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

import zmq

from messages.transport.context import move_aside as move_aside
from messages.transport.context import new_context as new_context
from messages.transport.endpoints import bind, connect, remove_ipc
from messages.transport.gate import Reopening

if TYPE_CHECKING:
    from messages.transport.endpoints import Context, Socket
    from messages.transport.gate import Gate
    from messages.transport.links import Links
    from messages.transport.waker import Waker

__all__ = [
    "SEND_QUEUE",
    "Publisher",
    "Subscription",
    "TimedOut",
]

SEND_QUEUE = 4096
"""Messages queued for one stalled listener before its newest ones are dropped: 8 s at 500 Hz, about 1 MB."""

# As plain numbers: pyzmq's enums cost more than the calls that take them.
_MORE = int(zmq.RCVMORE)
_EVENTS = int(zmq.EVENTS)
_SNDMORE = int(zmq.SNDMORE)
_NOBLOCK = int(zmq.NOBLOCK)
_POLLIN = int(zmq.POLLIN)

TimedOut = zmq.Again
"""Raised by `Subscription.next_frame` when nothing came in time."""


class Publisher:
    """What a node publishes: first to the next hop of the loop, then to whoever listens.

    Hop and listeners have a socket and an I/O thread each. So a tick goes on as soon as its message has left, what goes to
    loggers is carried by another core than the loop's, and no number of them is between a sample and its force.

    Parameters
    ----------
    context : zmq.Context
        Context of the process, made with ``aside`` when there is an endpoint for listeners.
    endpoint : str
        Where the next hop connects, see messages/transport/endpoints.py.
    more : iterable of str
        Further endpoints for hops, encrypted ones last.
    listen : iterable of str
        Endpoints for listeners; when there are none, they connect where the hops do.
    batch : int
        How many messages for listeners are collected before they are sent: waking another core costs more than a message.

    Attributes
    ----------
    endpoint : str
        Where the next hop connects.
    apart : bool
        Whether listeners have a socket of their own.

    Raises
    ------
    EndpointRefusedError, KeyRefusedError
        When an endpoint or this machine's keys cannot be used.
    """

    def __init__(
        self,
        context: Context,
        endpoint: str,
        more: Iterable[str] = (),
        listen: Iterable[str] = (),
        batch: int = 1,
    ) -> None:
        self._endpoints = ((endpoint, *more), tuple(listen))
        self._sockets: list[Socket] = []
        try:
            for thread, places in enumerate(self._endpoints):
                if places:
                    self._sockets.append(self._bound(context, thread, places))
        except ValueError:
            self._close_sockets(0)
            raise
        self.apart = len(self._sockets) > 1
        # pyzmq's own send, without the layer above it that looks for arguments nobody gives.
        self._hop = super(zmq.Socket, self._sockets[0]).send
        self._aside = super(zmq.Socket, self._sockets[-1]).send
        self._batch = batch
        self._held: list[tuple[bytes, bytes]] = []
        self._reopening = [Reopening(*one) for one in zip(self._sockets, filter(None, self._endpoints), strict=True)]
        self._subscriptions: Counter[bytes] = Counter()
        self.endpoint = endpoint

    def _bound(self, context: Context, thread: int, places: tuple[str, ...]) -> Socket:
        socket = context.socket(zmq.XPUB)
        socket.setsockopt(zmq.XPUB_VERBOSER, 1)
        socket.sndhwm = SEND_QUEUE
        # Bit 0 is the first I/O thread, bit 1 the second.
        socket.setsockopt(zmq.AFFINITY, 1 << thread)
        try:
            for place in places:
                bind(socket, place)
        except ValueError:
            socket.close(linger=0)
            raise
        return socket

    def lend(self) -> tuple[int, int, int]:
        """Let compiled code of the same thread do what `send` does.

        Returns
        -------
        tuple of int
            ZeroMQ's addresses of the sockets for hop and listeners (0 for none of their own), and messages in a batch.
        """
        return self._sockets[0].underlying, self._sockets[1].underlying if self.apart else 0, self._batch

    def send(self, topic: bytes, payload: bytes) -> None:
        """Publish one message to the next hop, then to the listeners: two frames, topic and payload.

        Parameters
        ----------
        topic : bytes
            Full topic name.
        payload : bytes
            An encoded message.
        """
        self._hop(topic, _SNDMORE)
        self._hop(payload)
        if self.apart:
            self._held.append((topic, payload))
            if len(self._held) >= self._batch:
                # Under FIFO the I/O thread, no more urgent than this one, still has the message for the hop.
                os.sched_yield()
                self.flush()

    def send_hop(self, topic: bytes, payload: bytes) -> None:
        """Publish one message to the next hop only; `send_aside` follows when the tick has its answer.

        Parameters
        ----------
        topic : bytes
            Full topic name.
        payload : bytes
            An encoded message.
        """
        self._hop(topic, _SNDMORE)
        self._hop(payload)

    def send_aside(self, topic: bytes, payload: bytes) -> None:
        """Publish one message to the listeners only: what no hop needs, or what it has already.

        Parameters
        ----------
        topic : bytes
            Full topic name.
        payload : bytes
            An encoded message.
        """
        self._held.append((topic, payload))
        if len(self._held) >= self._batch:
            self.flush()

    def flush(self) -> None:
        """Send what was collected for the listeners."""
        aside = self._aside
        for topic, payload in self._held:
            aside(topic, _SNDMORE)
            aside(payload)
        self._held.clear()

    def listeners(self) -> int:
        """Count those whose subscriptions have arrived, hops and listeners together.

        Returns
        -------
        int
            Live subscriptions to this publisher; every listener of a launch makes one.
        """
        self.tend(1000)
        return self._subscriptions.total()

    def tend(self, most: int = 128) -> bool:
        """Take in what listeners have sent, of which only subscriptions and their ends count, and not too many at once.

        Parameters
        ----------
        most : int
            How many at once; each costs the publishing thread a microsecond, and what is left waits in memory.

        Returns
        -------
        bool
            Whether there is more to take in.
        """
        for reopening in self._reopening:
            reopening.tend()
        for socket in self._sockets:
            while most and int(socket.get(_EVENTS)) & _POLLIN:
                most -= 1
                frame = socket.recv(_NOBLOCK)
                self._subscriptions[frame[1:]] += {b"\x00": -1, b"\x01": 1}.get(frame[:1], 0)
        # Whoever ends what nobody began must not be counted, nor remembered.
        self._subscriptions = +self._subscriptions
        return not most

    def evict(self) -> None:
        """End all tcp connections with the next `tend`; who is still allowed connects again. From any thread."""
        for reopening in self._reopening:
            reopening.ask()

    def watched_by(self, gate: Gate) -> None:
        """Let a gate watch who tries to connect to encrypted endpoints.

        Parameters
        ----------
        gate : Gate
            The gate of the process, not yet started.
        """
        for socket, places in zip(self._sockets, filter(None, self._endpoints), strict=True):
            if any("#" in place for place in places):
                gate.watch(socket)

    def _close_sockets(self, linger_ms: int) -> None:
        for socket in self._sockets:
            socket.close(linger=linger_ms)

    def close(self, linger_ms: int = 500) -> None:
        """Close the sockets and remove their files.

        Parameters
        ----------
        linger_ms : int
            How long queued messages may take to leave [ms].
        """
        self.flush()
        self._close_sockets(linger_ms)
        for places in self._endpoints:
            for place in places:
                remove_ipc(place)


class Subscription:
    """Topics of one or several publishers, received in order.

    Parameters
    ----------
    context : zmq.Context
        Context of the process.
    endpoints : iterable of str
        Publishers to connect to, see messages/transport/endpoints.py.
    topics : iterable of str
        Topics to take; ``""`` takes all.
    queue : int
        High-water mark; the default serves the loop, a logger takes more.
    links : Links, optional
        What looks after its connections: see messages/transport/links.py.

    Attributes
    ----------
    fd : int
        Descriptor to wait on: see `receive_until`.
    next_frame : callable
        Waits for the next frame for as long as `set_timeout` says, then raises `TimedOut`. For the loop, where each call
        costs a tick: it compares the first frame with the topic that it expects, and takes the second.

    Raises
    ------
    EndpointRefusedError, KeyRefusedError
        When an endpoint or this machine's keys cannot be used.
    """

    def __init__(
        self,
        context: Context,
        endpoints: Iterable[str],
        topics: Iterable[str],
        queue: int = 1000,
        links: Links | None = None,
    ) -> None:
        self._socket = context.socket(zmq.SUB)
        endpoints = list(endpoints)
        self._socket.rcvhwm = queue
        self._socket.setsockopt(zmq.AFFINITY, 1)
        self._timeout_ms = -1
        self._waker: Waker | None = None
        self.next_frame: Callable[..., bytes] = self._socket.recv
        self._returned: deque[bytes] = deque()
        self._get = self._socket.get
        self.fd = self._socket.FD
        if links is not None:
            links.watch(self._socket, endpoints)
        try:
            for endpoint in endpoints:
                connect(self._socket, endpoint)
        except ValueError:
            self._socket.close(linger=0)
            raise
        for topic in topics:
            self._socket.subscribe(topic)

    def lend(self) -> int:
        """Let compiled code of this thread receive; what is not for it is put back.

        Returns
        -------
        int
            ZeroMQ's address of the socket.
        """
        self.next_frame = self._next_frame
        return self._socket.underlying

    def register(self, poller: zmq.Poller) -> None:
        """Let a poller wait for it, where several are listened to; the loop waits with `receive_until`.

        Parameters
        ----------
        poller : zmq.Poller
            Of the thread that receives.
        """
        poller.register(self._socket, zmq.POLLIN)

    def put_back(self, frames: Iterable[bytes]) -> None:
        """Let the next ones be these frames, which were taken off the socket before."""
        self._returned.extend(frames)

    def _next_frame(self, flags: int = 0) -> bytes:
        return self._returned.popleft() if self._returned else self._socket.recv(flags)

    def woken_by(self, waker: Waker) -> None:
        """Let a waker end the waits of `next_frame`, which returns its frame then.

        Parameters
        ----------
        waker : Waker
            For a topic of this subscription; closed with it.
        """
        self._socket.connect(waker.endpoint)
        self._waker = waker

    def set_timeout(self, timeout_ms: int) -> None:
        """Set how long `next_frame` waits.

        Parameters
        ----------
        timeout_ms : int
            Longest wait [ms]; 0 does not wait, -1 waits without end.
        """
        if timeout_ms != self._timeout_ms:
            self._socket.rcvtimeo = timeout_ms
            self._timeout_ms = timeout_ms

    def _rest(self, topic: bytes) -> tuple[bytes, bytes]:
        """Take the second frame. A message of one frame has none; a third frame is met as the next message's first."""
        return (topic, self.next_frame()) if self._get(_MORE) else (b"", b"")

    def receive(self, timeout_ms: int) -> tuple[bytes, bytes] | None:
        """Wait for the next message with blocking receive (one wake-up, no poller).

        Parameters
        ----------
        timeout_ms : int
            Longest wait [ms]; 0 does not wait.

        Returns
        -------
        tuple of bytes or None
            Topic and payload; None when the time was over or it was woken, ``(b"", b"")`` for a message of one frame.
        """
        self.set_timeout(timeout_ms)
        try:
            topic = self.next_frame()
        except TimedOut:
            return None
        if self._waker is not None and topic == self._waker.frame:
            return None
        return self._rest(topic)

    def resynchronise(self) -> None:
        """Drop what is left of the present message, so that the next frame is a topic again.

        For whoever takes frames without asking where a message ends, which costs a tick about 3 µs: a message of one frame,
        or of three, shows as a topic that is not the one expected.
        """
        while self._get(_MORE):
            self.next_frame()

    def receive_soon(self, deadline: float) -> tuple[bytes, bytes] | None:
        """Wait for a message that is all but sure to come before a time: cheaper than `receive_until`.

        The wait is ZeroMQ's own, in whole milliseconds: should the message not come, this may return one after the deadline.

        Parameters
        ----------
        deadline : float
            Time on the monotonic clock [s].

        Returns
        -------
        tuple of bytes or None
            As `receive_until`.
        """
        self.set_timeout(max(1, int(1e3 * (deadline - time.monotonic()))))
        try:
            return self.next_frame(), self.next_frame()
        except TimedOut:
            return self.receive_until(deadline)

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
            Topic and payload; None when the time was over; an empty payload for a message of one frame.
        """
        while not self._returned and not self._get(_EVENTS) & _POLLIN:  # type: ignore[operator]  # an int, for this option
            remaining = deadline - time.monotonic()
            if remaining <= 0.0:
                return None
            select.select((self.fd,), (), (), remaining)
        topic = self.next_frame(_NOBLOCK)
        try:
            return topic, self.next_frame(_NOBLOCK)
        except TimedOut:
            return topic, b""

    def close(self) -> None:
        """Close the socket."""
        if self._waker is not None:
            self._waker.close()
        self._socket.close(linger=0)
