"""A family of laws, linear in its parameters, and how it is searched within a demand."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from sim.arrays import Array
from sim.design.demand import Demand, LoopCase, alternating, keeps, quiet


@dataclass(frozen=True)
class LinearFamily:
    """Laws whose taps are a matrix times their parameters."""

    demand: Demand
    basis: Array  # taps per unit of each parameter [N/m], shape (p, n + 1)
    fine: LoopCase  # the loop in all cases in which a law is verified
    free: bool = True  # whether parameters may be negative
    seed: int = 1
    effort: int = 1  # factor on the generations of global searches

    @property
    def gain(self) -> Array:
        """H(1) per unit of each parameter [N/m], shape (p,)."""
        return np.asarray(self.basis.sum(axis=1), dtype=np.float64)

    @property
    def noise(self) -> Array:
        """H(−1) per unit of each parameter [N/m], shape (p,)."""
        signs = alternating(self.basis.shape[1])
        return np.asarray(self.basis @ signs, dtype=np.float64)

    def stiffness(self, law: Array) -> float:
        """Return H(1) of a member, by its parameters [N/m]."""
        return float(law @ self.gain)

    def loop(self, cases: Array) -> LoopCase:
        """Return the loop in given cases."""
        return LoopCase(self.demand, cases, self.fine.taps, self.fine.pole)

    def keeps(self, law: Array) -> bool:
        """Check that a member meets the demand in all cases."""
        return keeps(self.demand, law @ self.basis, self.fine)

    def is_quiet(self, law: Array) -> bool:
        """Check that |H(−1)| of a member is within the demand."""
        return quiet(self.demand, law @ self.basis)

    def box(self, middle: Array, width: float) -> Array:
        """Return the lower and upper bounds of the parameters about a member, shape (2, p)."""
        low = middle - width
        return np.array([low if self.free else np.maximum(low, 0.0), middle + width])

    def evolving(self, loop: LoopCase, radius: float) -> tuple[Any, ...]:
        """Return the first arguments of `sim.design.evolution.evolve`, per unit of stiffness."""
        unit = self.demand.mass[0] / self.demand.period**2
        gain, noise = self.gain / unit, self.noise / unit
        bound = self.demand.nyquist / unit
        return loop.fixed, loop.by_tap, self.basis, gain, noise, bound, radius
