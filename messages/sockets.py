"""ZeroMQ sockets as the loop needs them: one bound publisher per node, listeners that connect, two frames per message.

The choices are measured ones: blocking receive rather than a poller, default high-water marks on loop sockets, no
CONFLATE (it corrupts multipart messages), and a publisher that sees its subscribers come (XPUB), so that a loop starts when
everybody listens instead of after a sleep.
"""

from __future__ import annotations

import contextlib
import os
import select
import time
from collections.abc import Iterable
from typing import TYPE_CHECKING

import zmq

from messages.codec import MAX_PAYLOAD

if TYPE_CHECKING:
    Context = zmq.Context[zmq.Socket[bytes]]
    Socket = zmq.Socket[bytes]

SEND_QUEUE = 4096
"""Messages queued for one stalled listener before its newest ones are dropped: 8 s at 500 Hz, about 1 MB."""

RECONNECT_MS = 20
"""How soon a listener tries again to reach a publisher that is not there yet or was respawned [ms]."""


def new_context() -> Context:
    """Make a context whose sockets never delay its end.

    Affinity and scheduling of the I/O thread are inherited: set them on the calling thread first.

    Returns
    -------
    zmq.Context
        With one I/O thread and linger 0.
    """
    context: Context = zmq.Context(io_threads=1)
    context.linger = 0
    return context


class Publisher:
    """A node's one publishing socket.

    Parameters
    ----------
    context : zmq.Context
        Context of the process.
    endpoint : str
        Where to bind, ``ipc://...`` or ``tcp://...``.
    """

    def __init__(self, context: Context, endpoint: str) -> None:
        self._socket = context.socket(zmq.XPUB)
        self._socket.setsockopt(zmq.XPUB_VERBOSER, 1)
        self._socket.sndhwm = SEND_QUEUE
        if endpoint.startswith("ipc://"):
            # A respawned node finds the socket file of its killed predecessor.
            with contextlib.suppress(FileNotFoundError):
                os.unlink(endpoint.removeprefix("ipc://"))
        self._socket.bind(endpoint)
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
            topic = frame[1:]
            self._peers[topic] = self._peers.get(topic, 0) + (1 if frame[:1] == b"\x01" else -1)

    def close(self, linger_ms: int = 500) -> None:
        """Close the socket and remove its file.

        Parameters
        ----------
        linger_ms : int
            How long queued messages may take to leave [ms].
        """
        self._socket.close(linger=linger_ms)
        remove_ipc(self.endpoint)


class Subscription:
    """Topics of one or several publishers, received in order.

    Parameters
    ----------
    context : zmq.Context
        Context of the process.
    endpoints : iterable of str
        Publishers to connect to.
    topics : iterable of str
        Topics to take; ``""`` takes all.
    queue : int
        High-water mark; the default serves the loop, a logger takes more.
    """

    def __init__(self, context: Context, endpoints: Iterable[str], topics: Iterable[str], queue: int = 1000) -> None:
        self._socket = context.socket(zmq.SUB)
        self._socket.rcvhwm = queue
        self._socket.setsockopt(zmq.RECONNECT_IVL, RECONNECT_MS)
        self._socket.setsockopt(zmq.MAXMSGSIZE, 16 * MAX_PAYLOAD)
        self._timeout_ms = -1
        self._recv = self._socket.recv
        self._fd = self._socket.FD
        for endpoint in endpoints:
            self._socket.connect(endpoint)
        for topic in topics:
            self._socket.subscribe(topic)

    def _rest(self, topic: bytes) -> tuple[bytes, bytes] | None:
        """Take the frames after the first; None when there are not exactly two, the whole message consumed."""
        if not self._socket.rcvmore:
            return None
        payload = self._recv(zmq.NOBLOCK)
        if not self._socket.rcvmore:
            return topic, payload
        while self._socket.rcvmore:
            self._recv(zmq.NOBLOCK)
        return None

    def receive(self, timeout_ms: int) -> tuple[bytes, bytes] | None:
        """Wait for the next message with blocking receive (one wake-up, no poller).

        Parameters
        ----------
        timeout_ms : int
            Longest wait [ms]; 0 does not wait.

        Returns
        -------
        tuple of bytes or None
            Topic and payload; None when the time was over, ``(b"", b"")`` for a message that was not of two frames.
        """
        if timeout_ms != self._timeout_ms:
            self._socket.rcvtimeo = timeout_ms
            self._timeout_ms = timeout_ms
        try:
            topic = self._recv()
        except zmq.Again:
            return None
        return self._rest(topic) or (b"", b"")

    def receive_until(self, deadline: float) -> tuple[bytes, bytes] | None:
        """Wait for the next message until an absolute time, to the microsecond.

        ZeroMQ's own time-outs are whole milliseconds, too coarse above 500 Hz, so the wait is a select on the socket's
        descriptor. That is edge-triggered: a receive must come back empty before each wait.

        Parameters
        ----------
        deadline : float
            Time on the monotonic clock [s].

        Returns
        -------
        tuple of bytes or None
            As `receive`.
        """
        while True:
            try:
                topic = self._recv(zmq.NOBLOCK)
            except zmq.Again:
                remaining = deadline - time.monotonic()
                if remaining <= 0.0:
                    return None
                select.select((self._fd,), (), (), remaining)
                continue
            return self._rest(topic) or (b"", b"")

    def close(self) -> None:
        """Close the socket."""
        self._socket.close(linger=0)


def remove_ipc(endpoint: str) -> None:
    """Remove the file of an ipc endpoint, if it has one.

    Parameters
    ----------
    endpoint : str
        Any endpoint.
    """
    if endpoint.startswith("ipc://"):
        with contextlib.suppress(FileNotFoundError):
            os.unlink(endpoint.removeprefix("ipc://"))
