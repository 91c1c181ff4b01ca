"""Punctuality of this machine: how late a thread wakes from sleeps to absolute times."""

from __future__ import annotations

import time

from nodes.base import realtime

WAKE_UPS = 250  # wake-ups measured
WAKE_UP_PERIOD = 0.002  # their period [s]


def wake_ups(period: float = WAKE_UP_PERIOD, count: int = WAKE_UPS) -> dict[str, float]:
    """Measure how late this thread wakes from sleeps to absolute times [µs]."""
    start = time.monotonic()
    deadlines = [start + k * period for k in range(1, count + 1)]
    late = sorted(realtime.sleep_until(deadline) - deadline for deadline in deadlines)
    p99 = min(int(0.99 * count), count - 1)
    places = {"p50": count // 2, "p99": p99, "max": -1}
    return {name: round(late[place] * 1e6, 1) for name, place in places.items()}
