"""How far apart two monotonic clocks are, measured by asking for the other one's time.

The time of a run is that of the launcher's host. Of a question asked at t0, answered with the other's time r and received at
t3, only so much is known: r was the other's time somewhere between t0 and t3. So the offset is (t0 + t3)/2 − r, off by at most
half the round trip; the shortest of the last round trips tells best (NTP's filter), and an old one loses worth at the rate at
which two crystals may drift apart.
"""

from __future__ import annotations

from collections import deque

DRIFT = 50e-6
"""How fast two monotonic clocks may drift apart [s/s]: two ordinary crystals of 25 ppm each."""

WINDOW = 16
"""Measurements that are kept."""


class ClockOffset:
    """Offset of another host's monotonic clock, from repeated questions."""

    def __init__(self) -> None:
        self._measured: deque[tuple[float, float, float]] = deque(maxlen=WINDOW)

    def add(self, asked: float, remote: float, answered: float) -> None:
        """Take one measurement."""
        if answered >= asked:
            self._measured.append((answered, (asked + answered) / 2.0 - remote, (answered - asked) / 2.0))

    def best(self, now: float) -> tuple[float, float]:
        """Give the offset that is known best."""
        if not self._measured:
            return 0.0, float("inf")
        bounds = [(half + DRIFT * max(now - when, 0.0), offset) for when, offset, half in self._measured]
        error, offset = min(bounds)
        return offset, error
