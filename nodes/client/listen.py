"""Listen to topics of a running launch from beside it, as any number of listeners may without the loop noticing."""

from __future__ import annotations

import time
from collections.abc import Collection, Iterator
from typing import NamedTuple

from messages.codec import Decoder, MessageRefusedError
from messages.topics import message_type, within
from messages.transport.context import new_context
from messages.transport.links import Links, say_link
from messages.transport.sockets import Subscription
from messages.types import Message
from nodes.base import realtime
from nodes.launcher.runs import RunInfo

QUIET_MS = 100
"""How often a listener that hears nothing looks up [ms]."""

QUEUE = 100_000
"""Messages that wait while the listener is busy."""


class Heard(NamedTuple):
    """A message and how it came."""

    topic: str  # its topic
    message: Message | None  # the message; None for one that was refused as malformed
    size: int  # bytes of both frames
    time: float  # when it was received, on the host's monotonic clock [s]


def listen(run: RunInfo, topics: Collection[str], duration: float = 0.0) -> Iterator[Heard | None]:
    """Receive messages until the run ends or the time is over."""
    # The socket's threads inherit it.
    with realtime.off(run.processors):
        yield from _listen(run, topics, duration)


def _listen(run: RunInfo, topics: Collection[str], duration: float) -> Iterator[Heard | None]:
    endpoints = run.endpoints()
    names = {within(run.namespace, topic).encode(): topic for topic in topics}
    decoders = {topic: Decoder(kind) for topic in topics if (kind := message_type(topic)) is not None}
    context = new_context()
    links = Links(context, say_link, say_link)
    inbox = Subscription(context, {endpoints[topic] for topic in topics}, map(bytes.decode, names), QUEUE, links)
    try:
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
            # A subscription is a prefix: what merely begins like a topic is not meant.
            topic = names.get(frames[0])
            if topic is None:
                continue
            message: Message | None
            try:
                message = decoders[topic].decode(frames[1])
            except MessageRefusedError:
                message = None
            yield Heard(topic, message, len(frames[0]) + len(frames[1]), now)
    finally:
        links.close()
        inbox.close()
        context.term()
