"""ZeroMQ subscriptions as the loop needs them: two frames per message, blocking receive.

The choices were measured: blocking receive rather than a poller, default high-water marks on loop
sockets, no CONFLATE (it corrupts multipart messages).
"""

import select
import time
from collections import deque
from collections.abc import Callable, Iterable

import zmq

from messages.transport.endpoints import Context, closed_if_refused, connect
from messages.transport.links import Links
from messages.transport.publisher import Publisher
from messages.transport.waker import Waker

__all__ = ["Publisher", "Subscription", "TimedOut"]

# plain numbers, because pyzmq's enums cost more than the calls that use them
_MORE = int(zmq.RCVMORE)
_EVENTS = int(zmq.EVENTS)
_NOBLOCK = int(zmq.NOBLOCK)
_POLLIN = int(zmq.POLLIN)

TimedOut = zmq.Again
"""Raised by `Subscription.next_frame` if nothing came in time."""


class Subscription:
    """Topics of one or several publishers, received in order.

    Parameters
    ----------
    context : zmq.Context
        Context of the process.
    endpoints : iterable of str
        Publishers to connect to, see messages/transport/endpoints.py.
    topics : iterable of str
        Topics to receive; ``""`` receives all.
    queue : int
        High-water mark; the default serves the loop, a logger uses more.
    links : Links, optional
        Monitor of its connections: see messages/transport/links.py.

    Attributes
    ----------
    fd : int
        Descriptor to wait on: see `receive_until`.
    next_frame : callable
        Waits for the next frame for as long as `set_timeout` says, then raises `TimedOut`. For the
        loop, where each call costs a tick: it compares the first frame with the expected topic, and
        receives the second.

    Raises
    ------
    EndpointRefusedError, KeyRefusedError
        If an endpoint or this machine's keys cannot be used.
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
        with closed_if_refused(self._socket):
            for endpoint in endpoints:
                connect(self._socket, endpoint)
        for topic in topics:
            self._socket.subscribe(topic)

    def native_handle(self) -> int:
        """Return the socket for compiled code of this thread, which puts back what it cannot use.

        Returns
        -------
        int
            ZeroMQ's address of the socket.
        """
        self.next_frame = self._next_frame
        return self._socket.underlying

    def register(self, poller: zmq.Poller) -> None:
        """Register with a `poller` of the receiving thread; the loop uses `receive_until`."""
        poller.register(self._socket, zmq.POLLIN)

    def put_back(self, frames: Iterable[bytes]) -> None:
        """Return frames to the head of the queue."""
        self._returned.extend(frames)

    def has_returned(self) -> bool:
        """Return whether frames that were put back wait; compiled code does not see them.

        Returns
        -------
        bool
            False if the next frame is on the socket.
        """
        return bool(self._returned)

    def _next_frame(self, flags: int = 0) -> bytes:
        return self._returned.popleft() if self._returned else self._socket.recv(flags)

    def woken_by(self, waker: Waker) -> None:
        """Make a `waker`, for a topic of this subscription and closed with it, end waits."""
        self._socket.connect(waker.endpoint)
        self._waker = waker

    def set_timeout(self, timeout_ms: int) -> None:
        """Set how long `next_frame` waits, `timeout_ms` [ms]; 0: no wait, -1: for ever."""
        if timeout_ms != self._timeout_ms:
            self._socket.rcvtimeo = timeout_ms
            self._timeout_ms = timeout_ms

    def _rest(self, topic: bytes) -> tuple[bytes, bytes]:
        """Receive the second frame of a message.

        A message of one frame has none; a third frame appears as the next message's first.
        """
        return (
            (topic, self.next_frame())
            if self._returned or self._get(_MORE)
            else (b"", b"")
        )

    def receive(self, timeout_ms: int) -> tuple[bytes, bytes] | None:
        """Wait for the next message for at most `timeout_ms` [ms], with one wake-up; 0: no wait.

        Returns
        -------
        tuple of bytes or None
            Topic and payload; None after a time-out or a wake-up, ``(b"", b"")`` for a message of
            one frame.
        """
        self.set_timeout(timeout_ms)
        try:
            topic = self.next_frame()
        except TimedOut:
            return None
        return (
            None
            if self._waker is not None and topic == self._waker.frame
            else self._rest(topic)
        )

    def resynchronise(self) -> None:
        """Discard the rest of the present message, so that the next frame is a topic again.

        For readers that do not check where a message ends, which costs a tick about 3 µs: a message
        of one frame, or of three, appears as an unexpected topic.
        """
        while self._get(_MORE):
            self.next_frame()

    def next_message(self, flags: int = 0) -> tuple[bytes, bytes]:
        """Receive two frames with ZeroMQ's `flags`, for comparison with the expected topic.

        Returns
        -------
        tuple of bytes
            Topic and payload; an empty payload for a message of one frame after which nothing came.
        """
        topic = self.next_frame(flags)
        try:
            return topic, self.next_frame(flags)
        except TimedOut:
            return topic, b""

    def receive_soon(self, deadline: float) -> tuple[bytes, bytes] | None:
        """Wait for a message that is almost certain to come before a `deadline` [s].

        Cheaper than `receive_until`: the wait is ZeroMQ's own, in whole milliseconds. Should the
        message not come, this may return one after the deadline.

        Returns
        -------
        tuple of bytes or None
            As `receive_until`.
        """
        self.set_timeout(max(1, int(1e3 * (deadline - time.monotonic()))))
        try:
            return self.next_message()
        except TimedOut:
            return self.receive_until(deadline)

    def receive_until(self, deadline: float) -> tuple[bytes, bytes] | None:
        """Wait for the next message until a monotonic `deadline` [s], to the microsecond.

        ZeroMQ's own time-outs are whole milliseconds, too coarse above 500 Hz, so the wait is a
        select on the socket's descriptor. That is edge-triggered: the socket must report that it
        has nothing before each wait.

        Returns
        -------
        tuple of bytes or None
            Topic and payload; None after the deadline; an empty payload for a message of one frame.
        """
        while not self._returned and not self._get(_EVENTS) & _POLLIN:  # type: ignore[operator]  # an int, for this option
            remaining = deadline - time.monotonic()
            if remaining <= 0.0:
                return None
            select.select((self.fd,), (), (), remaining)
        return self.next_message(_NOBLOCK)

    def close(self) -> None:
        """Close the socket."""
        if self._waker is not None:
            self._waker.close()
        self._socket.close(linger=0)
