"""Histogram of response times with microsecond bins, of constant size for any run.

The bins are scattered in memory, and a tick that touches them would wait. So a tick only writes its
response next to the last one; every `BLOCK` ticks they are counted together.
"""

from __future__ import annotations

from array import array
from typing import Final

from nodes.compiled.layout import state_of
from nodes.compiled.memory import wholes_at
from nodes.compiled.rules import rule
from nodes.driver.state import BINS, RECENT, DriverState

BLOCK: Final = 64  # responses counted together; a divisor of RECENT


@rule
def note_response(s: DriverState, response: float) -> None:
    """Record one response."""
    at = s.recent_at
    s.recent[at] = response
    at += 1
    if at % BLOCK == 0:
        bins = wholes_at(s.bins, BINS + 1)
        for k in range(at - BLOCK, at):
            bins[min(int(s.recent[k] * 1e6), BINS)] += 1
            s.longest = max(s.longest, s.recent[k])
        s.counted += BLOCK
        at %= RECENT
    s.recent_at = at


class ResponseTimes:
    """A histogram of response times, in a driver's state or one of its own."""

    def __init__(self, state: DriverState | None = None) -> None:
        self._state = state_of(DriverState) if state is None else state
        # counts by microseconds; the last one counts all longer responses, shape (BINS + 1,)
        self.bins = array("q", [0]) * (BINS + 1)
        self._state.bins = self.bins.buffer_info()[0]

    def add(self, response: float) -> None:
        """Record one response [s]."""
        note_response(self._state, response)

    @property
    def recent(self) -> bytes:
        """The newest responses [s], unordered; 0 where there was none yet."""
        return array("d", self._state.recent).tobytes()

    @property
    def count(self) -> int:
        """Number of answered ticks."""
        return int(self._state.counted + self._state.recent_at % BLOCK)

    @property
    def longest(self) -> float:
        """Longest response [s]."""
        return float(max(self._state.longest, *self._state.recent))

    def _percentile(self, bins: array[int], share: float) -> float:
        wanted = share * self.count
        seen = 0
        for bin_, number in enumerate(bins):
            seen += number
            if number and seen >= wanted and bin_ < BINS:
                return min((bin_ + 1) * 1e-6, self.longest)
        return self.longest

    def percentiles(self, *shares: float) -> list[float]:
        """Return the responses that the given shares of ticks did not exceed [s]."""
        bins = self.bins[:]
        at = self._state.recent_at
        for response in self._state.recent[at // BLOCK * BLOCK : at]:
            bins[min(int(response * 1e6), BINS)] += 1
        return [
            self._percentile(bins, share) if self.count else 0.0 for share in shares
        ]

    def summary_us(self) -> dict[str, float]:
        """Return percentiles and maximum [µs]."""
        named = zip(
            ("p50", "p99", "p999"), self.percentiles(0.5, 0.99, 0.999), strict=True
        )
        figures = {name: round(value * 1e6, 1) for name, value in named}
        return {**figures, "max": round(self.longest * 1e6, 1)}
