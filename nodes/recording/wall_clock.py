"""Wall-clock time in a recording: MCAP's times are dated for viewers, and taken back to the time of the run when read.

The run's own time is the host's monotonic clock, or simulated time; it has no date. The metadata
record ``clock`` holds how many whole nanoseconds were added, so that what is read is to the bit
what was recorded. Earlier recordings have none.
"""

from __future__ import annotations

import time
from collections.abc import Mapping

CLOCK = "clock"  # name of the metadata record
LOG_OFFSET, PUBLISH_OFFSET = "log_time_offset_ns", "publish_time_offset_ns"
"""What it holds: how far MCAP's times are ahead of the host's monotonic clock, and of the stamps [ns]."""

_LATEST = 1.8e10  # latest time that 64 bits of nanoseconds hold [s], rounded down
LATEST_NS = (1 << 64) - 1  # what MCAP can hold


def offsets_of(manifest: Mapping[str, str]) -> tuple[int, int]:
    """Tell how far MCAP's times are ahead of the run's, so that viewers date a recording by the wall clock."""
    try:
        wall = float(manifest["wall_minus_monotonic_s"])
        # Beyond what MCAP can hold it is no clock.
        offset = round(wall * 1e9) if abs(wall) < _LATEST else 0
    except (KeyError, ValueError):
        return 0, 0
    return offset, time.time_ns() if offset and manifest.get("pace") == "lockstep" else offset


def read_offsets(values: Mapping[str, str]) -> tuple[int, int]:
    """Read the ``clock`` record of a recording."""
    try:
        log, publish = (int(values[name]) for name in (LOG_OFFSET, PUBLISH_OFFSET))
    except (KeyError, ValueError) as error:
        raise ValueError(f"a clock record without times: {str(dict(values))[:200]}") from error
    if max(abs(log), abs(publish)) > LATEST_NS:
        raise ValueError(f"a clock record beyond 64 bits: {str(dict(values))[:200]}")
    return log, publish


def record(log: int, publish: int) -> dict[str, str]:
    """Write the content of the ``clock`` record."""
    return {LOG_OFFSET: str(log), PUBLISH_OFFSET: str(publish)}


def nanoseconds(seconds: float, offset: int) -> int:
    """Give a time as MCAP counts it: unsigned, 64 bits."""
    return min(max(round(min(max(seconds, -_LATEST), _LATEST) * 1e9) + offset, 0), LATEST_NS)
