"""The publisher of a node: one message to the next hop of the loop first, then to listeners.

Default high-water marks on loop sockets, and XPUB, which sees its subscribers come: a loop starts when everybody listens, not
after a sleep.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable
from typing import TYPE_CHECKING

import zmq

from messages.transport.endpoints import bind, remove_ipc
from messages.transport.gate import Reopening

if TYPE_CHECKING:
    from messages.transport.endpoints import Context, Socket
    from messages.transport.gate import Gate

SEND_QUEUE = 4096
"""Messages queued for one stalled listener before its newest ones are dropped: 8 s at 500 Hz, about 1 MB."""

# As plain numbers: pyzmq's enums cost more than the calls that take them.
_EVENTS = int(zmq.EVENTS)
_SNDMORE = int(zmq.SNDMORE)
_NOBLOCK = int(zmq.NOBLOCK)
_POLLIN = int(zmq.POLLIN)


class Publisher:
    """What a node publishes: first to the next hop of the loop, then to listeners.

    Hop and listeners have a socket and an I/O thread each. So a tick goes on as soon as its message has left, what goes to
    loggers is carried by another core than the loop's, and no number of them is between a sample and its force.

    `context`: context of the process, made with ``aside`` when there is an endpoint for listeners. `endpoint`: where the next
    hop connects, see messages/transport/endpoints.py. `more`: further endpoints for hops, encrypted ones last. `listen`:
    endpoints for listeners; when there are none, they connect where the hops do. `batch`: how many messages for listeners are
    collected before they are sent: waking another core costs more than a message. Raises EndpointRefusedError, KeyRefusedError
    when an endpoint or this machine's keys cannot be used.
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
        self.apart = len(self._sockets) > 1  # whether listeners have a socket of their own
        # pyzmq's own send, without the layer above it that looks for arguments nobody gives.
        self._hop = super(zmq.Socket, self._sockets[0]).send
        self._aside = super(zmq.Socket, self._sockets[-1]).send
        self._batch = batch
        self._held: list[tuple[bytes, bytes]] = []
        self._reopening = [Reopening(*one) for one in zip(self._sockets, filter(None, self._endpoints), strict=True)]
        self._subscriptions: Counter[bytes] = Counter()
        self.endpoint = endpoint  # where the next hop connects

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

    def native_handles(self) -> tuple[int, int, int]:
        """Let compiled code of the same thread do what `send` does.

        Returns: ZeroMQ's addresses of the sockets for hop and listeners (0 for none of their own), and messages in a batch.
        """
        return self._sockets[0].underlying, self._sockets[1].underlying if self.apart else 0, self._batch

    def send(self, topic: bytes, payload: bytes) -> None:
        """Publish one message to the next hop, then to the listeners: two frames, topic and payload."""
        self._hop(topic, _SNDMORE)
        self._hop(payload)
        if self.apart:
            self._held.append((topic, payload))
            if len(self._held) >= self._batch:
                # Under FIFO the I/O thread, no more urgent than this one, still has the message for the hop.
                os.sched_yield()
                self.flush()

    def send_hop(self, topic: bytes, payload: bytes) -> None:
        """Publish one message to the next hop only; `send_aside` follows when the tick has its answer."""
        self._hop(topic, _SNDMORE)
        self._hop(payload)

    def send_aside(self, topic: bytes, payload: bytes) -> None:
        """Publish one message to the listeners only: what no hop needs, or what it has already."""
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

        Returns: live subscriptions to this publisher; every listener of a launch makes one.
        """
        self.tend(1000)
        return self._subscriptions.total()

    def tend(self, most: int = 128) -> bool:
        """Take in what listeners have sent, of which only subscriptions and their ends count, and not too many at once.

        `most`: how many at once; each costs the publishing thread a microsecond, and what is left waits in memory. Returns:
        whether there is more to take in.
        """
        for reopening in self._reopening:
            reopening.tend()
        for socket in self._sockets:
            while most and int(socket.get(_EVENTS)) & _POLLIN:
                most -= 1
                frame = socket.recv(_NOBLOCK)
                self._subscriptions[frame[1:]] += {b"\x00": -1, b"\x01": 1}.get(frame[:1], 0)
        # A subscription that ends but never began must not be counted, nor remembered.
        self._subscriptions = +self._subscriptions
        return not most

    def evict(self) -> None:
        """End all tcp connections with the next `tend`; who is still allowed connects again. From any thread."""
        for reopening in self._reopening:
            reopening.ask()

    def watched_by(self, gate: Gate) -> None:
        """Let a gate watch who tries to connect to encrypted endpoints."""
        for socket, places in zip(self._sockets, filter(None, self._endpoints), strict=True):
            if any("#" in place for place in places):
                gate.watch(socket)

    def _close_sockets(self, linger_ms: int) -> None:
        for socket in self._sockets:
            socket.close(linger=linger_ms)

    def close(self, linger_ms: int = 500) -> None:
        """Close the sockets and remove their files.

        `linger_ms`: how long queued messages may take to leave [ms].
        """
        self.flush()
        self._close_sockets(linger_ms)
        for places in self._endpoints:
            for place in places:
                remove_ipc(place)
