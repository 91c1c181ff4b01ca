"""Listening to topics of a running launch, without any effect on its loop."""

import contextlib
import time
from collections.abc import Callable, Collection, Iterable, Iterator
from typing import NamedTuple

from messages.codec import Decoder, MessageRefusedError
from messages.topics import message_type, within
from messages.transport.context import new_context
from messages.transport.links import Links, say_link
from messages.transport.sockets import Subscription
from messages.types import Message
from nodes.base import realtime
from nodes.launcher.runs import RunInfo

QUIET_MS = 100  # how often an idle listener checks the run [ms]
QUEUE = 100_000  # messages that wait while the listener is busy


class Heard(NamedTuple):
    """A received message."""

    topic: str  # its topic
    message: Message | None  # None if it was malformed
    size: int  # bytes of both frames
    time: float  # time of reception, on the host's monotonic clock [s]


@contextlib.contextmanager
def listening(
    run: RunInfo,
    endpoints: Iterable[str],
    topics: Iterable[str],
    queue: int = QUEUE,
    say: Callable[[str], None] = say_link,
) -> Iterator[tuple[Subscription, Links]]:
    """Subscribe, off the processors of a run; `say` is called with changes of a link."""
    # inherited by the socket's threads, and by others started in the block
    with realtime.off(run.processors):
        context = new_context()
        links = Links(context, say, say)
        inbox = Subscription(context, endpoints, topics, queue, links)
        try:
            yield inbox, links
        finally:
            links.close()
            inbox.close()
            context.destroy(linger=0)


def listen(
    run: RunInfo, topics: Collection[str], duration: float = 0.0
) -> Iterator[Heard | None]:
    """Yield messages until the run ends or `duration` [s] is over; None while nothing arrives."""
    endpoints = run.endpoints()
    names = {within(run.namespace, topic).encode(): topic for topic in topics}
    decoders = {
        topic: Decoder(kind)
        for topic in topics
        if (kind := message_type(topic)) is not None
    }
    with listening(
        run, {endpoints[topic] for topic in topics}, map(bytes.decode, names)
    ) as (inbox, links):
        until = time.monotonic() + duration if duration else float("inf")
        while True:
            frames = inbox.receive(QUIET_MS)
            links.keep()
            now = time.monotonic()
            if now >= until:
                return
            if frames is None:
                if not run.lives:
                    return
                yield None
                continue
            # A subscription matches by prefix: discard topics that only begin like a wanted one.
            topic = names.get(frames[0])
            if topic is None:
                continue
            message: Message | None
            try:
                message = decoders[topic].decode(frames[1])
            except MessageRefusedError:
                message = None
            yield Heard(topic, message, len(frames[0]) + len(frames[1]), now)
