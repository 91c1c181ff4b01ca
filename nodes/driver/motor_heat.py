"""The motor's heating: a force may be large for a while, but not for long, and it must be taken down without a jump.

Heat is the mean square of the force, forgotten with one time constant. Cutting the force when the heat reaches its limit
would be a jump of several newtons under somebody's hand, so the force is lowered early enough: at any time the way down to
the continuous force, at the slew limit, still fits below the heat limit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

HALVINGS = 24
"""Steps of the bisection between the forces that are safe and wanted: 1e-7 of their difference."""


class Motor:
    """Keeps the root-mean-square force within a limit.

    Let φ = exp(−T/τ), h the heat [N²] and C the limit. Before each tick holds φh + (1−φ)(F² + R(F)) ≤ C², where
    R(F) = (F³ − C³)/(3s) for F > C bounds the sum of the squares on the way down from F to C in steps of s. Going down by s
    keeps that inequality, so there is always a force that respects it.

    Parameters
    ----------
    continuous : float
        Largest root-mean-square force C [N].
    thermal_time : float
        Time constant τ [s].
    period : float
        Sampling period T [s].
    slew : float or None
        Largest change of force per tick s [N]; None for no limit.

    Attributes
    ----------
    heat : float
        Mean square of the force, forgotten with τ [N²].
    """

    def __init__(self, continuous: float, thermal_time: float, period: float, slew: float | None) -> None:
        self._bound = continuous * continuous
        self._continuous = continuous
        self._keep = math.exp(-period / thermal_time)
        self._slew = slew
        self._largest = 0.0
        self.heat = 0.0

    def close(self, held: Sequence[float], ticks: int) -> None:
        """Count the tick that is over, and further ones during which the force was held."""
        if ticks > 0:
            self.heat = self._keep * self.heat + (1.0 - self._keep) * self._largest
            rest = self._keep ** (ticks - 1)
            self.heat = rest * self.heat + (1.0 - rest) * sum(value * value for value in held)
        self._largest = 0.0

    def note(self, force: Sequence[float]) -> None:
        """Note a force of this tick; the largest one counts."""
        self._largest = max(self._largest, sum(value * value for value in force))

    def _fits(self, force: Sequence[float]) -> bool:
        squared = sum(value * value for value in force)
        size = math.sqrt(squared)
        way = 0.0
        if self._slew is not None and size > self._continuous:
            way = (size**3 - self._continuous**3) / (3.0 * self._slew)
        return self._keep * self.heat + (1.0 - self._keep) * (squared + way) <= self._bound

    def lower(self, last: Sequence[float], wanted: list[float], left: float | None) -> list[float]:
        """Lower a force as far as the heat asks for."""
        if self._fits(wanted):
            return wanted
        largest = max(map(abs, last))
        share = 0.0 if left is None or left >= largest else 1.0 - left / largest
        safe = [value * share for value in last]
        low, high = 0.0, 1.0
        found = safe
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            between = [a + middle * (b - a) for a, b in zip(safe, wanted, strict=True)]
            if self._fits(between):
                low, found = middle, between
            else:
                high = middle
        return found
