"""The figures of a run, computed from its recording and from nothing else, so that a summary is true to the file."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from typing import cast

import msgspec

from messages.topics import DEVICE_STATE
from messages.types import DeviceState
from nodes.recording.reader import Recording

# which quantiles of the response time are given
QUANTILES = {"p50": 0.5, "p99": 0.99, "p999": 0.999, "max": 1.0}


class Summary(msgspec.Struct):
    """Figures of one run, as its driver recorded them."""

    # Ticks whose outcome is recorded: each state tells how the tick before it went, the last one
    # ends the run.
    ticks: int
    duration_s: float  # from the earliest state's stamp to the latest one's [s]
    rate_hz: float  # mean rate while a driver ticked [1/s]; 0 for fewer than two ticks
    # Ticks of the recording not answered in time, and ticks left out because the driver was late;
    # None without states.
    missed: int | None
    overruns: int | None
    # p50, p99, p999 and max of the response time of the ticks answered in time [µs]; empty when
    # there are none.
    response_us: dict[str, float]
    age_ticks_max: int | None  # oldest force that was used [ticks]; None without states
    # Position and force at the end [m, N]; empty when no state was recorded, shape (3,).
    position_m: list[float]
    force_n: list[float]


def quantile(ordered: Sequence[float], fraction: float) -> float:
    """Quantile with linear interpolation between the two nearest values (type 7 of Hyndman and Fan 1996)."""
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
    span, response_times = 0.0, array("d")
    for entry in recording.entries([DEVICE_STATE]):
        before, last = last, cast("DeviceState", entry.message)
        oldest = max(oldest, last.age)
        # The tick after it holds a response; 0 says that there was none in time.
        if last.response > 0.0:
            response_times.append(last.response * 1e6)
        # A driver that was started again counts anew, and tells nothing of the tick before.
        if before is not None and last.seq > before.seq:
            ticks += 1
            seqs += last.seq - before.seq
            span += last.stamp - before.stamp
            missed += max(last.missed - before.missed, 0)
            overruns += max(last.overruns - before.overruns, 0)
    assert last is not None  # noqa: S101  # a topic of the recording has a message
    figures = recording.topics[DEVICE_STATE]
    responses = sorted(response_times)
    return Summary(
        ticks=ticks,
        duration_s=figures.last_stamp - figures.first_stamp,
        rate_hz=seqs / span if span > 0.0 else 0.0,
        missed=missed,
        overruns=overruns,
        response_us=(
            {name: quantile(responses, f) for name, f in QUANTILES.items()} if responses else {}
        ),
        age_ticks_max=oldest,
        position_m=list(last.position),
        force_n=list(last.force),
    )
