"""Replay a recording at its original pace, for plotting programs and nodes."""

from __future__ import annotations

import time
from collections.abc import Collection, Iterator, Mapping

from messages.codec import encode
from messages.transport.open_port import OpenPort
from nodes.recording.reader import Entry, Recording


def play(
    recording: Recording,
    publisher: OpenPort,
    *,
    rate: float = 1.0,
    topics: Collection[str] | None = None,
    offset: float = 0.0,
    remap: Mapping[str, str] | None = None,
) -> Iterator[Entry]:
    """Publish recorded messages at the pace they were received, from `offset` [s] on.

    Stamps and seq stay unchanged. Yields each entry after sending it.
    """
    if not rate > 0.0:
        raise ValueError(f"rate is {rate}, must be above 0")
    names, begin, first = remap or {}, time.monotonic(), recording.first_log + offset
    for entry in recording.entries(topics):
        if entry.log_time < first:
            continue
        # Absolute targets, so that delays do not accumulate.
        ahead = begin + (entry.log_time - first) / rate - time.monotonic()
        if ahead > 0.0:
            time.sleep(ahead)
        publisher.send(names.get(entry.topic, entry.topic).encode(), encode(entry.message))
        publisher.keep()
        yield entry
