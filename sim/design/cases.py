"""The loop at all cases that a design is searched and verified on: masses, delays, hands, dampings."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from nodes.stability.flexible import FlexiblePlant
from nodes.stability.plant import Plant, held_plant
from nodes.stability.roots import largest_roots
from sim.arrays import Array
from sim.design.demand import Demand

_VERIFIED = 801


class LoopCase:
    """Closed-loop polynomials at given cases (mass, delay, hand), linear in the taps."""

    def __init__(self, demand: Demand, cases: Array, taps: int, pole: float = 0.0) -> None:
        plants = [
            _rational(demand.period, case, beyond) for case in cases.tolist() for beyond in demand.beyond or (None,)
        ]
        # A shorter delay is the same polynomial times a power of z: roots at zero that nobody minds.
        size = max(whole + len(below) for whole, _, below in plants) + taps + (pole != 0.0)
        self.taps, self.pole = taps, pole
        self._cases = len(cases)
        self.fixed = np.zeros((len(plants), size))
        self.by_tap = np.zeros((len(plants), taps, size))
        for i, (whole, above, below) in enumerate(plants):
            self.fixed[i, : len(below)] = below
            self.fixed[i, 1:] -= pole * self.fixed[i, :-1].copy()
            for j in range(taps):
                start = whole + 1 + j
                self.by_tap[i, j, start : start + len(above)] = above

    def polynomials(self, taps: Array) -> Array:
        """Coefficients of (..., taps) for every case: (..., cases, size)."""
        return np.asarray(self.fixed + np.einsum("...j,ijk->...ik", taps, self.by_tap), dtype=np.float64)

    def radii(self, taps: Array) -> Array:
        """Largest pole radius of each case, over all that the device may have beyond a rigid mass."""
        found = largest_roots(self.polynomials(taps))
        return np.asarray(found.reshape(*found.shape[:-1], self._cases, -1).max(axis=-1), dtype=np.float64)

    def poles(self, taps: Array) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """All poles (cases, k) and their slopes along the taps (cases, k, taps)."""
        polynomials = self.polynomials(taps)
        degree = polynomials.shape[1] - 1
        companion = np.zeros((len(polynomials), degree, degree))
        companion[:, 0, :] = -polynomials[:, 1:]
        companion[:, np.arange(1, degree), np.arange(degree - 1)] = 1.0
        poles = np.asarray(np.linalg.eigvals(companion), dtype=np.complex128)
        powers = poles[:, :, None] ** np.arange(degree, -1, -1)
        steep = np.einsum("ik,ipk->ip", polynomials[:, :-1] * np.arange(degree, 0, -1), powers[:, :, 1:])
        steep = np.where(np.abs(steep) < 1e-9, 1e-9, steep)
        slopes = -np.einsum("ijk,ipk->ipj", self.by_tap, powers) / steep[:, :, None]
        return poles, slopes


def _rational(
    period: float, case: Sequence[float], beyond: tuple[float, float, float, float] | None
) -> tuple[int, Sequence[float], Sequence[float]]:
    """Whole ticks of the delay, numerator and denominator of the device of a case."""
    mass, delay, hand, damping = case
    if beyond is None:
        plant = held_plant(Plant(period, mass, damping, delay, hand))
        return plant.whole, plant.numerator, plant.denominator
    lag, share, frequency, loss = beyond
    whole, above, below = FlexiblePlant(mass, damping, delay, hand, lag, share, frequency, loss).rational(period)
    return whole, above.tolist(), below.tolist()


def verified_cases(demand: Demand) -> Array:
    """Cases on which a design is verified after the search.

    Returns, shape (c, 4): mass [kg], delay [ticks], stiffness of the hand [N/m], damping of the device [N s/m]: 801 masses
    evenly spaced in the logarithm, or 101 masses with 11 delays and hands and 5 dampings where those are ranges too, fewer for
    a device that is more than a rigid mass; all ends are among them.
    """
    ranges = (demand.delay, demand.stiffness, demand.dampings)
    if demand.beyond:
        # Each case is one of each: fewer masses, as close as the poles move smoothly.
        return cases_of(demand, 51 if all(low == high for low, high in ranges) else 21, 5)
    return cases_of(demand, 101 if any(low < high for low, high in ranges) else _VERIFIED, 11)


def cases_of(demand: Demand, masses: int, others: int) -> Array:
    """Grid of cases over the ranges of a demand, shape (c, 4) as in `verified_cases`."""
    axes = [
        np.geomspace(*demand.mass, masses) if demand.mass[0] < demand.mass[1] else np.array(demand.mass[:1]),
        np.linspace(*demand.delay, others) if demand.delay[0] < demand.delay[1] else np.array(demand.delay[:1]),
        np.linspace(*demand.stiffness, others)
        if demand.stiffness[0] < demand.stiffness[1]
        else np.array(demand.stiffness[:1]),
        np.linspace(*demand.dampings, min(others, 5)) if demand.damping_max is not None else np.array([demand.damping]),
    ]
    return np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")], axis=1)


def alternating(size: int) -> Array:
    """Signs of the taps in H(−1)."""
    return np.asarray(np.where(np.arange(size) % 2, -1.0, 1.0), dtype=np.float64)


def quiet(demand: Demand, taps: Array) -> bool:
    """Tell whether |H(−1)| keeps the demand."""
    return abs(float(taps @ alternating(taps.size))) <= demand.nyquist * (1.0 + 1e-12)


def keeps(demand: Demand, taps: Array, loop: LoopCase) -> bool:
    """Tell whether taps keep the demand at all cases of a loop."""
    return quiet(demand, taps) and float(loop.radii(taps).max()) <= demand.radius
