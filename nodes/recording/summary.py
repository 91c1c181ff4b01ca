"""Figures of a run, computed from its recording alone."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import msgspec

from messages.topics import DEVICE_STATE
from messages.types import DeviceState
from nodes.driver.response_times import ResponseTimes
from nodes.recording.reader import Recording


class Summary(msgspec.Struct):
    """Figures of a run as its driver recorded them."""

    # Ticks whose outcome is recorded: each state reports the outcome of the tick before it.
    ticks: int
    duration_s: float  # time from the earliest to the latest state's stamp [s]
    rate_hz: float  # mean rate while a driver ticked [1/s]; 0 for fewer than two ticks
    # Ticks not answered in time, and ticks left out because the driver was late; None without
    # states.
    missed: int | None
    overruns: int | None
    # p50, p99, p999 and max response time of the ticks answered in time [µs]; empty if none.
    response_us: dict[str, float]
    # age of the oldest force used [ticks]; None without states
    age_ticks_max: int | None
    # Final position [m] and force [N], shape (3,); empty if no state was recorded.
    position_m: list[float]
    force_n: list[float]


def quantile(ordered: Sequence[float], fraction: float) -> float:
    """Return a quantile by linear interpolation (type 7 of Hyndman and Fan 1996)."""
    place = (len(ordered) - 1) * fraction
    low = int(place)
    high = min(low + 1, len(ordered) - 1)
    return ordered[low] + (ordered[high] - ordered[low]) * (place - low)


def summarise(recording: Recording) -> Summary:
    """Compute the figures of a run."""
    if DEVICE_STATE not in recording.topics:
        return Summary(0, 0.0, 0.0, None, None, {}, None, [], [])
    last: DeviceState | None = None
    ticks = seqs = missed = overruns = oldest = 0
    # the driver's own histogram, so that a launch and its plot give the same figures
    span = 0.0
    times = ResponseTimes()
    for entry in recording.entries([DEVICE_STATE]):
        before = last
        last = cast("DeviceState", entry.message)
        oldest = max(oldest, last.age)
        # A state holds the response time of the tick before; 0 if not answered in time.
        if last.response > 0.0:
            times.add(last.response)
        # A restarted driver counts from zero and reports nothing about the tick before.
        if before is not None and last.seq > before.seq:
            ticks += 1
            seqs += last.seq - before.seq
            span += last.stamp - before.stamp
            missed += max(last.missed - before.missed, 0)
            overruns += max(last.overruns - before.overruns, 0)
    assert last is not None  # noqa: S101  # a topic of the recording has a message
    figures = recording.topics[DEVICE_STATE]
    return Summary(
        ticks=ticks,
        duration_s=figures.last_stamp - figures.first_stamp,
        rate_hz=seqs / span if span > 0.0 else 0.0,
        missed=missed,
        overruns=overruns,
        response_us=times.summary_us() if times.count else {},
        age_ticks_max=oldest,
        position_m=list(last.position),
        force_n=list(last.force),
    )
