"""Following the ticks of another node: newest message wins, gaps and restarts are counted, never hidden."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

from messages.codec import Decoder, MessageRefusedError
from messages.transport.sockets import Subscription, TimedOut
from messages.types import MAX_COUNT, Message
from nodes.base.node import IDLE_MS, Node

M = TypeVar("M", bound=Message)


def follow(node: Node, inbox: Subscription, decoder: Decoder[M], topic: str) -> Callable[[], M | None]:
    """Follow one loop topic for a node that answers it.

    In real time a message that is older than a period when it arrives is skipped if a newer one is already there: a
    node that was stalled goes on with the present, not with what piled up. In lockstep every message is taken.
    """
    topic = node.setup.topic(topic)
    expected = topic.encode()
    ticks = node.make_compiled()
    realtime, period = node.setup.pace == "realtime", node.setup.period
    next_frame, decode, clock = inbox.next_frame, decoder.decode, time.monotonic
    waker = node.waker
    patience = IDLE_MS if waker is None else -1

    def newest(message: M) -> M:
        while (frames := inbox.receive(0)) is not None:
            newer = node.take(decoder, frames, expected)
            if newer is not None:
                node.skipped += 1
                message = newer
        inbox.set_timeout(patience)
        return message

    def out_of_order(seq: int) -> None:
        last = node.followed
        missing = seq - last - 1
        if missing > 0 and last >= 0:
            node.gaps = min(node.gaps + missing, MAX_COUNT)
        elif seq < last:
            node.events.emit("restart", f"{topic} went back from tick {last} to {seq}")

    def take() -> M | None:
        try:
            frame = next_frame()
        except TimedOut:
            return None
        if frame != expected:
            if waker is None or frame != waker.frame:
                node.out_of_step(frame, expected)
            return None
        try:
            payload = next_frame()
            while payload == expected:
                # A message of one frame, and the beginning of the next.
                node.events.refuse(f"a message of one frame on {topic}, where topic and payload were expected")
                payload = next_frame()
            message = decode(payload)
        except TimedOut:
            node.events.refuse(f"a message on {topic} without a payload")
            return None
        except MessageRefusedError as error:
            node.events.refuse(str(error))
            return None
        if realtime and clock() + node.clock.offset - message.stamp > period:
            message = newest(message)
        node.seq = seq = message.seq
        if seq != node.followed + 1:
            out_of_order(seq)
        node.followed = seq
        return message

    inbox.set_timeout(patience)
    return take if ticks is None else ticks.in_front_of(take)
