"""Following the ticks of another node: newest message wins, gaps and restarts are counted, never hidden."""

from __future__ import annotations

import time
from typing import Generic, TypeVar

from messages.codec import Decoder
from messages.sockets import Subscription
from messages.types import Message
from nodes.base import Node

M = TypeVar("M", bound=Message)


class Follower(Generic[M]):
    """Takes one loop topic for a node.

    In real time a message that is older than a period when it arrives is skipped if a newer one is already there: a
    node that was stalled goes on with the present, not with what piled up. In lockstep every message is taken.

    Parameters
    ----------
    node : Node
        The node that follows; its counters are kept here.
    inbox : Subscription
        Its socket.
    decoder : Decoder
        For the topic's type.
    topic : str
        The topic.
    """

    def __init__(self, node: Node, inbox: Subscription, decoder: Decoder[M], topic: str) -> None:
        self._node = node
        self._receive = inbox.receive_tick
        self._decoder = decoder
        self._topic = topic.encode()
        self._realtime = node.setup.pace == "realtime"
        self._period = node.setup.period
        self._last = -1

    def take(self, timeout_ms: int) -> M | None:
        """Wait for the next message.

        Parameters
        ----------
        timeout_ms : int
            Longest wait [ms].

        Returns
        -------
        Message or None
            None when nothing valid came in time.
        """
        node = self._node
        frames = self._receive(timeout_ms)
        if frames is None:
            return None
        message = node.take(self._decoder, frames, self._topic)
        if message is None:
            return None
        if self._realtime and time.monotonic() + node.clock_offset - message.stamp > self._period:
            message = self._newest(message)
        seq = message.seq
        if seq != self._last + 1:
            self._out_of_order(seq)
        self._last = node.seq = seq
        return message

    def _newest(self, message: M) -> M:
        while (frames := self._receive(0)) is not None:
            newer = self._node.take(self._decoder, frames, self._topic)
            if newer is not None:
                self._node.skipped += 1
                message = newer
        return message

    def _out_of_order(self, seq: int) -> None:
        missing = seq - self._last - 1
        if missing > 0 and self._last >= 0:
            self._node.gaps += missing
        elif seq < self._last:
            self._node.tell("restart", f"{self._topic.decode()} went back from tick {self._last} to {seq}")
