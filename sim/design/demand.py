"""Specification of a designed law, the law found, and the closed loop over all cases.

A case is one mass, delay, hand stiffness and damping from the specified ranges.
"""

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nodes.laws import CompiledLaw
from nodes.stability.flexible import FlexiblePlant
from nodes.stability.plant import Plant, held_plant
from nodes.stability.roots import largest_roots
from sim.arrays import Array

# Contact conventions: (raw history, clamp), where clamp sets forces into the floor to zero.
CONVENTIONS = ((False, True), (False, False), (True, True), (True, False))
# Values of `Demand.beyond` for a rigid device: lag [s], share of the mass behind the joint, joint
# frequency [Hz], damping ratio.
RIGID = (0.0, 0.0, math.inf, 0.0)


@dataclass(frozen=True)
class Demand:
    """Requirements a law must meet, whatever its stiffness."""

    # lightest and heaviest device, including the hand's share [kg], shape (2,)
    mass: tuple[float, float]
    # viscous damping b of the device, the minimum if it is a range [N s/m]
    damping: float
    # shortest and longest delay of the loop, may be fractional [ticks], shape (2,)
    delay: tuple[float, float]
    period: float  # sampling period T [s]
    # largest pole radius R allowed at any mass, delay and hand in the ranges
    radius: float
    nyquist: float  # largest |H(−1)| allowed [N/m]
    stiffness: tuple[float, float] = (
        0.0,
        0.0,
    )  # softest and stiffest hand [N/m], shape (2,)
    # maximum damping of the device; None if it is known [N s/m]
    damping_max: float | None = None
    # Contact conventions (raw history, clamped force) under which every drop must also settle, with
    # a margin (`sim.design.landing`); empty if impact stability is not required.
    lands: tuple[tuple[bool, bool], ...] = ()
    # H(1) of a law already known: the search skips drop tests for softer laws [N/m]
    above: float = 0.0
    # Deviations from one rigid mass; the law must be stable with each of them. Each is: actuator
    # lag [s], share of the mass behind a joint, joint frequency [Hz], damping ratio. Empty for a
    # rigid device.
    beyond: tuple[tuple[float, float, float, float], ...] = ()

    @property
    def dampings(self) -> tuple[float, float]:
        """Return the minimum and maximum damping of the device [N s/m]."""
        return (
            self.damping,
            self.damping if self.damping_max is None else self.damping_max,
        )


@dataclass(frozen=True)
class Robust:
    """The stiffest law found in a family."""

    # h_0 ... h_n, or the numerator over 1 − pole·w [N/m], shape (n + 1,)
    taps: Array
    parameters: Array  # weights of the family's basis, shape (p,)
    h1_n_per_m: float  # H(1) [N/m]
    h_nyquist_n_per_m: float  # H(−1) [N/m]
    radius: float  # largest pole radius over all verified cases
    # the case with that radius: mass [kg], delay [ticks], hand stiffness [N/m], device damping [N
    # s/m], shape (4,)
    worst: tuple[float, ...]
    # pole of the filter behind two taps (`pd_filtered`); 0: no filter
    pole: float = 0.0

    @property
    def law(self) -> CompiledLaw:
        """Return the law as the coupling renders it: taps, or one tap and a filter section."""
        return filtered(self.taps, self.pole)


def filtered(taps: Array, pole: float) -> CompiledLaw:
    """Compile taps h_0 ... h_n [N/m], or two taps over 1 − pole·w.

    With a pole, the law is a spring plus a filtered backward difference.
    """
    if pole == 0.0:
        return CompiledLaw(tuple(taps.tolist()))
    newest, older = taps.tolist()
    spring = (newest + older) / (1.0 - pole)
    return CompiledLaw((spring,), ((newest - spring, spring - newest, -pole, 0.0),))


_VERIFIED = 801


class LoopCase:
    """Closed-loop polynomials of given cases (mass, delay, hand), linear in the taps."""

    def __init__(
        self, demand: Demand, cases: Array, taps: int, pole: float = 0.0
    ) -> None:
        plants = [
            _rational(demand.period, case, beyond)
            for case in cases.tolist()
            for beyond in demand.beyond or (None,)
        ]
        # A shorter delay gives the same polynomial times a power of z, which only adds roots at
        # zero.
        size = (
            max(whole + len(below) for whole, _, below in plants) + taps + (pole != 0.0)
        )
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
        """Return the coefficients for taps (..., taps) in every case: (..., cases, size)."""
        return np.asarray(
            self.fixed + np.einsum("...j,ijk->...ik", taps, self.by_tap),
            dtype=np.float64,
        )

    def radii(self, taps: Array) -> Array:
        """Return the largest pole radius of each case over all `Demand.beyond` devices."""
        found = largest_roots(self.polynomials(taps))
        return np.asarray(
            found.reshape(*found.shape[:-1], self._cases, -1).max(axis=-1),
            dtype=np.float64,
        )

    def poles(
        self, taps: Array
    ) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """Return all poles (cases, k) and their derivatives by the taps (cases, k, taps)."""
        polynomials = self.polynomials(taps)
        degree = polynomials.shape[1] - 1
        companion = np.zeros((len(polynomials), degree, degree))
        companion[:, 0, :] = -polynomials[:, 1:]
        companion[:, np.arange(1, degree), np.arange(degree - 1)] = 1.0
        poles = np.asarray(np.linalg.eigvals(companion), dtype=np.complex128)
        powers = poles[:, :, None] ** np.arange(degree, -1, -1)
        steep = np.einsum(
            "ik,ipk->ip",
            polynomials[:, :-1] * np.arange(degree, 0, -1),
            powers[:, :, 1:],
        )
        steep = np.where(np.abs(steep) < 1e-9, 1e-9, steep)
        return poles, -np.einsum("ijk,ipk->ipj", self.by_tap, powers) / steep[
            :, :, None
        ]


def _rational(
    period: float,
    case: Sequence[float],
    beyond: tuple[float, float, float, float] | None,
) -> tuple[int, Sequence[float], Sequence[float]]:
    """Return whole ticks of delay, numerator and denominator of the device of a case."""
    mass, delay, hand, damping = case
    if beyond is None:
        plant = held_plant(Plant(period, mass, damping, delay, hand))
        return plant.whole, plant.numerator, plant.denominator
    lag, share, frequency, loss = beyond
    whole, above, below = FlexiblePlant(
        mass, damping, delay, hand, lag, share, frequency, loss
    ).rational(period)
    return whole, above.tolist(), below.tolist()


def verified_cases(demand: Demand) -> Array:
    """Return the cases for verification, including all range ends, shape (c, 4).

    Columns: mass [kg], delay [ticks], hand stiffness [N/m], damping [N s/m].
    """
    ranges = (demand.delay, demand.stiffness, demand.dampings)
    if demand.beyond:
        # The number of cases is multiplied by len(beyond); fewer masses suffice because poles move
        # smoothly.
        return cases_of(
            demand, 51 if all(low == high for low, high in ranges) else 21, 5
        )
    return cases_of(
        demand, 101 if any(low < high for low, high in ranges) else _VERIFIED, 11
    )


def cases_of(demand: Demand, masses: int, others: int) -> Array:
    """Return a grid of cases over the ranges of a demand, shape (c, 4) as in `verified_cases`."""
    axes = [
        (
            np.geomspace(*demand.mass, masses)
            if demand.mass[0] < demand.mass[1]
            else np.array(demand.mass[:1])
        ),
        (
            np.linspace(*demand.delay, others)
            if demand.delay[0] < demand.delay[1]
            else np.array(demand.delay[:1])
        ),
        (
            np.linspace(*demand.stiffness, others)
            if demand.stiffness[0] < demand.stiffness[1]
            else np.array(demand.stiffness[:1])
        ),
        (
            np.linspace(*demand.dampings, min(others, 5))
            if demand.damping_max is not None
            else np.array([demand.damping])
        ),
    ]
    return np.stack(
        [axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")], axis=1
    )


def corners(demand: Demand) -> Iterator[FlexiblePlant]:
    """Yield the devices for which a law is certified, without delay.

    These are five masses combined with the ends of damping and hand stiffness and with every joint
    and lag of the demand.
    """
    masses = np.unique(np.geomspace(*demand.mass, 5)).tolist()
    ends = (
        masses,
        sorted(set(demand.dampings)),
        sorted(set(demand.stiffness)),
        demand.beyond or (RIGID,),
    )
    for mass, damping, hand, beyond in itertools.product(*ends):
        yield FlexiblePlant(mass, damping, 0.0, hand, *beyond)


def alternating(size: int) -> Array:
    """Return the signs of the taps in H(−1)."""
    return np.asarray(np.where(np.arange(size) % 2, -1.0, 1.0), dtype=np.float64)


def quiet(demand: Demand, taps: Array) -> bool:
    """Check that |H(−1)| is within the demand."""
    return abs(float(taps @ alternating(taps.size))) <= demand.nyquist * (1.0 + 1e-12)


def keeps(demand: Demand, taps: Array, loop: LoopCase) -> bool:
    """Check that taps meet the demand in all cases of a loop."""
    return quiet(demand, taps) and float(loop.radii(taps).max()) <= demand.radius
