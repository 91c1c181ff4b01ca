"""Answering the ticks of another node: the newest message wins; gaps are counted."""

import time
from collections.abc import Callable, Mapping
from typing import TypeVar

from messages.codec import Decoder, MessageRefusedError
from messages.transport.sockets import Subscription, TimedOut
from messages.types import MAX_COUNT, Message
from nodes.base.node import IDLE_MS, Node

M = TypeVar("M", bound=Message)


# other topics of the subscription, and callbacks for their payloads
Hear = Mapping[bytes, Callable[[bytes], None]]


def _follow(
    node: Node, inbox: Subscription, decoder: Decoder[M], topic: str, hear: Hear
) -> Callable[[], M | None]:
    """Return a function that receives the next message of a loop topic.

    In real time a node that was stalled continues with the newest message, not with the queue.
    """
    expected = topic.encode()
    ticks = node.make_compiled()
    counters = node.counters
    realtime = node.setup.pace == "realtime"
    period = node.setup.period
    next_frame, decode, clock = inbox.next_frame, decoder.decode, time.monotonic
    waker = node.waker
    newest = _make_newest(node, inbox, decoder, expected, hear)

    def take() -> M | None:
        try:
            frame = next_frame()
        except TimedOut:
            return None
        if frame != expected:
            if frame in hear:
                _pass_on(node, hear[frame], next_frame, frame)
            elif waker is None or frame != waker.frame:
                node.intake.out_of_step(frame, expected)
            return None
        try:
            payload = next_frame()
            while payload == expected:
                # A message of one frame, and the beginning of the next.
                node.events.refuse(
                    f"a message of one frame on {topic}, where topic and payload were expected"
                )
                payload = next_frame()
            message = decode(payload)
        except TimedOut:
            node.events.refuse(f"a message on {topic} without a payload")
            return None
        except MessageRefusedError as error:
            node.events.refuse(str(error))
            return None
        # A newer message that compiled ticks have put back must not stay there: they continue at
        # the socket.
        if realtime and (
            clock() + node.clock.offset - message.stamp > period or inbox.has_returned()
        ):
            message = newest(message)
        seq, last = message.seq, counters.seq
        if seq != last + 1:
            _count_gap(node, topic, seq, last)
        counters.seq = seq
        return message

    inbox.set_timeout(_patience(node))
    return take if ticks is None else ticks.in_front_of(take)


def _patience(node: Node) -> int:
    """Return how long a node waits for a message [ms]; -1 for a node that is woken."""
    return IDLE_MS if node.waker is None else -1


def _make_newest(
    node: Node, inbox: Subscription, decoder: Decoder[M], expected: bytes, hear: Hear
) -> Callable[[M], M]:
    """Return the function that skips messages of the followed topic for the newest one."""
    patience = _patience(node)

    def newest(message: M) -> M:
        while (frames := inbox.receive(0)) is not None:
            if frames[0] in hear:
                hear[frames[0]](frames[1])
                continue
            newer = node.intake.take(decoder, frames, expected)
            if newer is not None:
                node.counters.skipped += 1
                message = newer
        inbox.set_timeout(patience)
        return message

    return newest


def _count_gap(node: Node, topic: str, seq: int, last: int) -> None:
    """Count missing ticks, or report that the driver counts anew."""
    missing = seq - last - 1
    if missing > 0 and last >= 0:
        node.counters.gaps = min(node.counters.gaps + missing, MAX_COUNT)
    elif seq < last:
        node.events.emit(
            "restart",
            f"{topic} went back from tick {last} to {seq}",
            {"last_tick": last, "tick": seq},
        )


def _pass_on(
    node: Node,
    hear: Callable[[bytes], None],
    next_frame: Callable[[], bytes],
    frame: bytes,
) -> None:
    """Pass the payload of another topic to its callback."""
    try:
        hear(next_frame())
    except TimedOut:
        node.events.refuse(f"a message on {frame.decode()} without a payload")


def answer_ticks(
    node: Node,
    message: type[M],
    topic: str,
    answers_on: str,
    respond: Callable[[M], bytes | None],
    hear: Hear | None = None,
) -> None:
    """Answer each tick of a loop topic with the result of `respond`, until stopped.

    `hear` maps full names of other topics of the same subscription to callbacks for their payloads.
    """
    inbox = node.inbox
    assert inbox is not None  # noqa: S101  # every subscribing kind has one
    node.state = "running"
    take = _follow(node, inbox, Decoder(message), node.setup.topic(topic), hear or {})
    send, send_again = node.publisher.send, node.publisher.send_hop
    to = node.setup.topic(answers_on).encode()
    counters = node.counters
    events = node.events
    while not node.stopping:
        taken = take()
        if taken is not None:
            if taken.seq == counters.answered:
                # Asked again (lockstep, after a lost answer): send the same answer to the waiting
                # node only. Neither memory nor listeners may see the tick twice.
                send_again(to, node.answer)
            elif (payload := respond(taken)) is not None:
                counters.answered = taken.seq
                node.answer = payload
                # before sending: a client that has the answer must find it counted
                counters.ticks += 1
                send(to, payload)
        if events.waiting:
            node.between_ticks(counters.seq + 1)
