"""Delays at which a loop may be judged a moment later: a measured delay and its range.

The measured delay wanders. What a refusal suggests is judged again when it is typed, so it must be
stable at any delay that the loop is likely to have then.
"""

from __future__ import annotations

from collections import deque
from typing import Final

SPAN: Final = 10.0  # time in which the delay's range is measured [s]
BIN: Final = 0.5  # time whose samples are stored as one range [s]


class LikelyDelays:
    """Range of a measured delay over the last seconds."""

    def __init__(self) -> None:
        # beginning of a bin, and its smallest and largest sample
        self._bins: deque[tuple[float, float, float]] = deque()

    def add(self, now: float, delay: float) -> None:
        """Add a sample [s, ticks]."""
        began, low, high = self._bins[-1] if self._bins else (now, delay, delay)
        if self._bins and now - began < BIN:
            self._bins[-1] = (began, min(low, delay), max(high, delay))
        else:
            self._bins.append((now, delay, delay))
        while now - self._bins[0][0] > SPAN:
            self._bins.popleft()

    def around(self, delay: float) -> tuple[float, float]:
        """Return the present delay less and plus the range of the last seconds [ticks].

        Whatever it is, a delay within the range is between both.
        """
        low = min([delay, *(low for _, low, _ in self._bins)])
        high = max([delay, *(high for _, _, high in self._bins)])
        spread = high - low
        return max(0.0, delay - spread), delay + spread
