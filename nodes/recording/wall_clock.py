"""Convert between the time of a run and MCAP's wall-clock times.

The run's own time is the host's monotonic clock or simulated time, without a date; viewers need
dated times. The metadata record ``clock`` stores the integer offsets added [ns], so that reading
restores the recorded times exactly. Earlier recordings have no such record.
"""

from __future__ import annotations

import time
from collections.abc import Mapping

CLOCK = "clock"  # name of the metadata record
LOG_OFFSET, PUBLISH_OFFSET = "log_time_offset_ns", "publish_time_offset_ns"
"""Entries of the record: MCAP time minus monotonic clock, and minus stamp [ns]."""

_LATEST = 1.8e10  # latest time that 64 bits of nanoseconds hold [s], rounded down
LATEST_NS = (1 << 64) - 1  # latest time that MCAP can store


def offsets_of(manifest: Mapping[str, str]) -> tuple[int, int]:
    """Return the offsets from the run's time to MCAP's log and publish times [ns]."""
    try:
        wall = float(manifest["wall_minus_monotonic_s"])
        # Beyond MCAP's range it is no clock.
        offset = round(wall * 1e9) if abs(wall) < _LATEST else 0
    except (KeyError, ValueError):
        return 0, 0
    return offset, time.time_ns() if offset and manifest.get(
        "pace"
    ) == "lockstep" else offset


def read_offsets(values: Mapping[str, str]) -> tuple[int, int]:
    """Return both offsets of the ``clock`` record [ns]."""
    try:
        log, publish = (int(values[name]) for name in (LOG_OFFSET, PUBLISH_OFFSET))
    except (KeyError, ValueError) as error:
        raise ValueError(
            f"a clock record without times: {str(dict(values))[:200]}"
        ) from error
    if max(abs(log), abs(publish)) > LATEST_NS:
        raise ValueError(f"a clock record beyond 64 bits: {str(dict(values))[:200]}")
    return log, publish


def record(log: int, publish: int) -> dict[str, str]:
    """Return the content of the ``clock`` record."""
    return {LOG_OFFSET: str(log), PUBLISH_OFFSET: str(publish)}


def nanoseconds(seconds: float, offset: int) -> int:
    """Convert a time to MCAP's unsigned 64-bit nanoseconds."""
    return min(
        max(round(min(max(seconds, -_LATEST), _LATEST) * 1e9) + offset, 0), LATEST_NS
    )
