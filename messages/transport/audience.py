"""Who listens to a publisher: counted by their subscriptions, and put out when they send more than those.

What listeners send is taken in by the thread that publishes, so little of it is taken in between two messages, and what
ZeroMQ keeps for a listener is bounded by the number of its subscriptions.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import zmq

from messages.transport.doors import Peer

if TYPE_CHECKING:
    from messages.transport.endpoints import Socket

MOST_SUBSCRIPTIONS = 64
"""Subscriptions of one listener; who has more is put out."""

UPSTREAM_QUEUE = 16
"""Frames from one listener that are taken in between two messages."""

_EVENTS = int(zmq.EVENTS)
_POLLIN = int(zmq.POLLIN)


class _Talker:
    """A listener, by what it sends."""

    def __init__(self, peer: Peer) -> None:
        self.peer, self.subscriptions, self._is_out = peer, 0, False

    def put_out(self, reason: str) -> str:
        """End its connection; the reason, the first time."""
        self.peer.cut()
        told, self._is_out = "" if self._is_out else reason, True
        return told


class Audience:
    """Those who listen to the sockets of one publisher.

    Parameters
    ----------
    sockets : sequence of tuple
        XPUB sockets with XPUB_VERBOSER, and an endpoint of each for reports.
    """

    def __init__(self, sockets: Sequence[tuple[Socket, str]]) -> None:
        self._sockets = sockets
        self._peers: dict[tuple[int, bytes], int] = {}
        self._talkers: dict[int, _Talker] = {}

    def count(self) -> int:
        """Count the subscriptions that were taken in and not ended."""
        return sum(self._peers.values())

    def tend(self, most: int) -> tuple[list[str], bool]:
        """Take in what was sent."""
        out: list[str] = []
        for i, (socket, place) in enumerate(self._sockets):
            while most and int(socket.get(_EVENTS)) & _POLLIN:
                most -= 1
                reason = self._take_upstream(i, socket.recv(zmq.NOBLOCK, copy=False))
                if reason:
                    out.append(f"{place.partition('#')[0]}: {reason}")
        return out, not most

    def _take_upstream(self, i: int, frame: zmq.Frame) -> str:
        content = frame.bytes
        change = {b"\x00": -1, b"\x01": 1}.get(content[:1], 0)
        if change:
            key = (i, content[1:])
            count = self._peers[key] = self._peers.get(key, 0) + change
            if not count:
                del self._peers[key]
        try:
            descriptor = int(frame.get(zmq.SRCFD))
        except zmq.ZMQError:
            # What ZeroMQ itself says of a listener that is gone comes from nowhere.
            return ""
        talker = self._talkers.get(descriptor)
        if talker is None or not talker.peer.is_there():
            talker = self._talkers[descriptor] = _Talker(Peer(descriptor))
        talker.subscriptions += change
        if not change:
            return talker.put_out("a listener that sends messages of its own is put out")
        if talker.subscriptions > MOST_SUBSCRIPTIONS:
            return talker.put_out(
                f"a listener with more than {MOST_SUBSCRIPTIONS} subscriptions, the limit, is put out"
            )
        return ""
