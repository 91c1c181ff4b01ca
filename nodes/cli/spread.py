"""Count, mean and spread of a stream of numbers without keeping them (Welford 1962)."""

from __future__ import annotations

import math


class Spread:
    """Running figures.

    `low`, `high`: smallest and largest; 0 without values.
    """

    def __init__(self) -> None:
        self.count = 0  # values so far
        self.mean = self.low = self.high = 0.0  # their mean; 0 without values
        self._squares = 0.0

    def add(self, value: float) -> None:
        """Take one value."""
        self.count += 1
        if self.count == 1:
            self.low = self.high = value
        elif value < self.low:
            self.low = value
        elif value > self.high:
            self.high = value
        off = value - self.mean
        self.mean += off / self.count
        self._squares += off * (value - self.mean)

    @property
    def deviation(self) -> float:
        """Standard deviation of the values themselves (divided by their count); 0 without values."""
        return math.sqrt(self._squares / self.count) if self.count else 0.0

    def figures(self) -> dict[str, float]:
        """Tell all of them."""
        return {"mean": self.mean, "min": self.low, "max": self.high, "std": self.deviation}
