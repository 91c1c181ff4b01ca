"""Counting response times: one bin per microsecond, so that percentiles of any length of run cost no memory.

The bins lie scattered over memory, and a tick that touches them waits for it. So a tick only writes its response next to the
last one; every `BLOCK` ticks they are counted together.
"""

from __future__ import annotations

from array import array

BINS = 50_000
RECENT = 512
"""Newest response times that are kept as they are, for the status line."""

BLOCK = 64
"""Responses that are counted together; a divisor of RECENT."""


class ResponseTimes:
    """A histogram of response times.

    Attributes
    ----------
    recent : array of float, shape (RECENT,)
        The newest responses [s], in no order; 0 where there was none yet.
    at : int
        Where in it the next one goes.
    bins : array of int, shape (BINS + 1,)
        How many took so many microseconds; the last one counts all that took longer.
    counted, longest_counted : int, float
        How many are in the bins, and the longest of them [s].
    """

    def __init__(self) -> None:
        self.bins = array("Q", [0]) * (BINS + 1)
        self.counted = 0
        self.longest_counted = 0.0
        self.at = 0
        self.recent = array("d", [0.0]) * RECENT

    def add(self, response: float) -> None:
        """Note one response."""
        at = self.at
        self.recent[at] = response
        at += 1
        if at % BLOCK == 0:
            self._count(self.bins, at)
            self.longest_counted = max(self.longest_counted, *self.recent[at - BLOCK : at])
            self.counted += BLOCK
            at %= RECENT
        self.at = at

    def _count(self, bins: array[int], end: int) -> None:
        """Count the responses of a block that ends there."""
        for response in self.recent[(end - 1) // BLOCK * BLOCK : end]:
            bin_ = int(response * 1e6)
            bins[bin_ if bin_ < BINS else BINS] += 1

    @property
    def count(self) -> int:
        """Ticks that were answered."""
        return self.counted + self.at % BLOCK

    @property
    def longest(self) -> float:
        """Longest response [s]."""
        return max(self.longest_counted, *self.recent)

    def _percentile(self, bins: array[int], share: float) -> float:
        wanted = share * self.count
        seen = 0
        for bin_, number in enumerate(bins):
            seen += number
            if number and seen >= wanted and bin_ < BINS:
                return min((bin_ + 1) * 1e-6, self.longest)
        return self.longest

    def percentiles(self, *shares: float) -> list[float]:
        """Find the responses that shares of the ticks did not exceed."""
        bins = self.bins[:]
        if self.at % BLOCK:
            self._count(bins, self.at)
        return [self._percentile(bins, share) if self.count else 0.0 for share in shares]

    def summary_us(self) -> dict[str, float]:
        """Summarise in microseconds."""
        named = zip(("p50", "p99", "p999"), self.percentiles(0.5, 0.99, 0.999), strict=True)
        figures = {name: round(value * 1e6, 1) for name, value in named}
        return {**figures, "max": round(self.longest * 1e6, 1)}
