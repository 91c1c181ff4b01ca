"""Publisher of a node: sends to the next hop of the loop first, then to listeners.

It uses default high-water marks on loop sockets, and XPUB, which reports subscriptions: a loop
starts when everybody listens, not after a sleep.
"""

import os
from collections import Counter
from collections.abc import Iterable

import zmq

from messages.transport.endpoints import (
    Context,
    Socket,
    bind,
    closed_if_refused,
    remove_ipc,
)
from messages.transport.gate import Gate, Reopening

# messages queued for one stalled listener before its newest are dropped: 8 s at 500 Hz, 1 MB
SEND_QUEUE = 4096

# plain numbers, because pyzmq's enums cost more than the calls that use them
_EVENTS = int(zmq.EVENTS)
_SNDMORE = int(zmq.SNDMORE)
_NOBLOCK = int(zmq.NOBLOCK)
_POLLIN = int(zmq.POLLIN)


class Publisher:
    """Publishes to the next hop of the loop at `endpoint`, then to listeners.

    Hop and listeners have a socket and an I/O thread each. So a tick continues as soon as its
    message has left, messages to loggers are sent by another core than the loop's, and listeners,
    however many, never delay a force. `more`: further endpoints for hops, encrypted ones last.
    `listen`: endpoints for listeners, with a context made ``aside``; without any they connect where
    the hops do. `batch`: messages collected for listeners before they are sent, because waking
    another core costs more than a message.
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
        for thread, places in enumerate(self._endpoints):
            if places:
                with closed_if_refused(*self._sockets):
                    self._sockets.append(self._bound(context, thread, places))
        # whether listeners have a socket of their own
        self.apart = len(self._sockets) > 1
        # pyzmq's own send, without the layer above it that checks unused arguments
        self._hop = super(zmq.Socket, self._sockets[0]).send
        self._aside = super(zmq.Socket, self._sockets[-1]).send
        self._batch = batch
        self._held: list[tuple[bytes, bytes]] = []
        self._reopening = [
            Reopening(*one)
            for one in zip(self._sockets, filter(None, self._endpoints), strict=True)
        ]
        self._subscriptions: Counter[bytes] = Counter()
        self.endpoint = endpoint  # where the next hop connects

    def _bound(self, context: Context, thread: int, places: tuple[str, ...]) -> Socket:
        socket = context.socket(zmq.XPUB)
        socket.setsockopt(zmq.XPUB_VERBOSER, 1)
        socket.sndhwm = SEND_QUEUE
        # Bit 0 is the first I/O thread, bit 1 the second.
        socket.setsockopt(zmq.AFFINITY, 1 << thread)
        with closed_if_refused(socket):
            for place in places:
                bind(socket, place)
        return socket

    def native_handles(self) -> tuple[int, int, int]:
        """Return both sockets' ZeroMQ addresses (0: none) and the batch, for compiled code."""
        return (
            self._sockets[0].underlying,
            self._sockets[1].underlying if self.apart else 0,
            self._batch,
        )

    def send(self, topic: bytes, payload: bytes) -> None:
        """Publish one message, topic and payload, to the next hop, then to the listeners."""
        self._hop(topic, _SNDMORE)
        self._hop(payload)
        if self.apart:
            self._held.append((topic, payload))
            if len(self._held) >= self._batch:
                # Under FIFO the I/O thread, no more urgent than this one, still has the message for
                # the hop.
                os.sched_yield()
                self.flush()

    def send_hop(self, topic: bytes, payload: bytes) -> None:
        """Publish one message to the next hop only; `send_aside` follows after the answer."""
        self._hop(topic, _SNDMORE)
        self._hop(payload)

    def send_aside(self, topic: bytes, payload: bytes) -> None:
        """Publish one message to the listeners only."""
        self._held.append((topic, payload))
        if len(self._held) >= self._batch:
            self.flush()

    def flush(self) -> None:
        """Send the messages collected for listeners."""
        aside = self._aside
        for topic, payload in self._held:
            aside(topic, _SNDMORE)
            aside(payload)
        self._held.clear()

    def listeners(self) -> int:
        """Return the number of live subscriptions, of hops and listeners; one per listener."""
        self.maintain(1000)
        return self._subscriptions.total()

    def maintain(self, most: int = 128) -> bool:
        """Process at most `most` subscription changes, 1 µs each. Return whether more wait."""
        for reopening in self._reopening:
            reopening.maintain()
        for socket in self._sockets:
            while most and int(socket.get(_EVENTS)) & _POLLIN:
                most -= 1
                frame = socket.recv(_NOBLOCK)
                self._subscriptions[frame[1:]] += {b"\x00": -1, b"\x01": 1}.get(
                    frame[:1], 0
                )
        # the end of an unknown subscription must not count, nor be remembered
        self._subscriptions = +self._subscriptions
        return not most

    def evict(self) -> None:
        """Request the end of all tcp connections; allowed peers reconnect. From any thread."""
        for reopening in self._reopening:
            reopening.ask()

    def watched_by(self, gate: Gate) -> None:
        """Make a gate monitor connections to encrypted endpoints."""
        for socket, places in zip(
            self._sockets, filter(None, self._endpoints), strict=True
        ):
            if any("#" in place for place in places):
                gate.watch(socket)

    def close(self, linger_ms: int = 500) -> None:
        """Close the sockets and remove their files; queued messages may take `linger_ms` [ms]."""
        self.flush()
        for socket in self._sockets:
            socket.close(linger=linger_ms)
        for places in self._endpoints:
            for place in places:
                remove_ipc(place)
