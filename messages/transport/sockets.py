"""ZeroMQ sockets as the loop needs them: one bound publisher per node, listeners that connect, two frames per message.

The choices are measured ones: blocking receive rather than a poller, default high-water marks on
loop sockets, no CONFLATE (it corrupts multipart messages).
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

# As plain numbers: pyzmq's enums cost more than the calls that take them.
_MORE = int(zmq.RCVMORE)
_EVENTS = int(zmq.EVENTS)
_NOBLOCK = int(zmq.NOBLOCK)
_POLLIN = int(zmq.POLLIN)

TimedOut = zmq.Again
"""Raised by `Subscription.next_frame` when nothing came in time."""


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
        Waits for the next frame for as long as `set_timeout` says, then raises `TimedOut`. For the
        loop, where each call costs a tick: it compares the first frame with the topic that it
        expects, and takes the second.

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
        with closed_if_refused(self._socket):
            for endpoint in endpoints:
                connect(self._socket, endpoint)
        for topic in topics:
            self._socket.subscribe(topic)

    def native_handle(self) -> int:
        """Let compiled code of this thread receive; what is not for it is put back.

        Returns
        -------
        int
            ZeroMQ's address of the socket.
        """
        self.next_frame = self._next_frame
        return self._socket.underlying

    def register(self, poller: zmq.Poller) -> None:
        """Let a `poller` of the receiving thread wait for it, among several; the loop waits with `receive_until`."""
        poller.register(self._socket, zmq.POLLIN)

    def put_back(self, frames: Iterable[bytes]) -> None:
        """Let the next ones be these frames, which were taken off the socket before."""
        self._returned.extend(frames)

    def has_returned(self) -> bool:
        """Whether frames that were put back are still to be taken; compiled code, which looks at the socket, misses them.

        Returns
        -------
        bool
            False as soon as what comes next is on the socket.
        """
        return bool(self._returned)

    def _next_frame(self, flags: int = 0) -> bytes:
        return self._returned.popleft() if self._returned else self._socket.recv(flags)

    def woken_by(self, waker: Waker) -> None:
        """Let a `waker`, for a topic of this subscription and closed with it, end the waits of `next_frame` by its frame."""
        self._socket.connect(waker.endpoint)
        self._waker = waker

    def set_timeout(self, timeout_ms: int) -> None:
        """Set how long `next_frame` waits: `timeout_ms` [ms]; 0 does not wait, -1 waits without end."""
        if timeout_ms != self._timeout_ms:
            self._socket.rcvtimeo = timeout_ms
            self._timeout_ms = timeout_ms

    def _rest(self, topic: bytes) -> tuple[bytes, bytes]:
        """Take the second frame. A message of one frame has none; a third frame is met as the next message's first."""
        return (topic, self.next_frame()) if self._returned or self._get(_MORE) else (b"", b"")

    def receive(self, timeout_ms: int) -> tuple[bytes, bytes] | None:
        """Wait for the next message with blocking receive (one wake-up, no poller), `timeout_ms` at most [ms]; 0 does not wait.

        Returns
        -------
        tuple of bytes or None
            Topic and payload; None when the time was over or it was woken, ``(b"", b"")`` for a
            message of one frame.
        """
        self.set_timeout(timeout_ms)
        try:
            topic = self.next_frame()
        except TimedOut:
            return None
        return None if self._waker is not None and topic == self._waker.frame else self._rest(topic)

    def resynchronise(self) -> None:
        """Drop what is left of the present message, so that the next frame is a topic again.

        For readers that take frames without asking where a message ends, which costs a tick about 3
        µs: a message of one frame, or of three, shows as a topic that is not the one expected.
        """
        while self._get(_MORE):
            self.next_frame()

    def next_message(self, flags: int = 0) -> tuple[bytes, bytes]:
        """Take two frames, as `next_frame` does with ZeroMQ's `flags`; the caller compares both with the topic that it expects.

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
        """Wait for a message that is all but sure to come before a `deadline` [s]: cheaper than `receive_until`.

        The wait is ZeroMQ's own, in whole milliseconds: should the message not come, this may
        return one after the deadline.

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
        """Wait for the next message until a `deadline` on the monotonic clock [s], to the microsecond.

        ZeroMQ's own time-outs are whole milliseconds, too coarse above 500 Hz, so the wait is a
        select on the socket's descriptor. That is edge-triggered: the socket must have said that it
        has nothing before each wait.

        Returns
        -------
        tuple of bytes or None
            Topic and payload; None when the time was over; an empty payload for a message of one
            frame.
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
