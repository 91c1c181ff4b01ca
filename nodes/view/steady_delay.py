"""The loop's delay for maps: the median of some seconds, so that no edge wanders."""

from __future__ import annotations

from collections import deque
from statistics import median

SPAN = 10.0  # time span of the median [s]
PERIOD = 0.1  # time between two samples [s]


class SteadyDelay:
    """Samples a delay and returns its median."""

    def __init__(self) -> None:
        self._samples: deque[tuple[float, float]] = deque()

    def add(self, now: float, delay: float) -> None:
        """Add a sample [s, ticks], if the last one is `PERIOD` old."""
        kept = self._samples
        if kept and now - kept[-1][0] < PERIOD:
            return
        kept.append((now, delay))
        while now - kept[0][0] > SPAN:
            kept.popleft()

    def median(self, otherwise: float) -> float:
        """Return the median delay over `SPAN` [ticks]; `otherwise` before the first sample."""
        if not self._samples:
            return otherwise
        return median(delay for _, delay in self._samples)
