"""Replay a recording at its original pace, for plotting programs and nodes."""

from __future__ import annotations

import time
from collections.abc import Collection, Iterator, Mapping

from messages.codec import encode
from messages.topics import DEVICE_STATE
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
    """Publish recorded messages at their original pace, from `offset` [s] on.

    The pace is that of their receipt, or in simulated time that of their stamps: a lockstep run
    may have taken less or more time than it simulated. Stamps and seq stay unchanged. Yields each
    entry after sending it.
    """
    if not rate > 0.0:
        raise ValueError(f"rate is {rate}, must be above 0")
    simulated = in_simulated_time(recording)
    names = remap or {}
    begin = time.monotonic()
    first = (recording.first_stamp if simulated else recording.first_log) + offset
    last = recording.first_stamp + recording.duration
    for entry in recording.entries(topics):
        at = min(entry.message.stamp, last) if simulated else entry.log_time
        if offset and at < first:
            continue
        # Absolute targets, so that delays do not accumulate.
        ahead = begin + (at - first) / rate - time.monotonic()
        if ahead > 0.0:
            time.sleep(ahead)
        publisher.send(
            names.get(entry.topic, entry.topic).encode(), encode(entry.message)
        )
        publisher.keep()
        yield entry


def in_simulated_time(recording: Recording) -> bool:
    """Whether the time of a run is that of its stamps, not that of their receipt.

    Stamps of a real-time run are real time too, so a file that has lost its manifest is played by
    the stamps of its ticks.
    """
    pace = recording.manifest.get("pace")
    return DEVICE_STATE in recording.topics if pace is None else pace != "realtime"


def length_of(recording: Recording) -> float:
    """Return how long `play` takes at the original pace [s]."""
    return (
        recording.duration if in_simulated_time(recording) else recording.wall_duration
    )
