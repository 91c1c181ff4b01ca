"""What a law for an unknown world must bear: hand, worlds, and the demand on it."""

import math
from dataclasses import dataclass

import numpy as np

from nodes.laws import CompiledLaw
from nodes.stability.cosine_sums import Laurent, one_less_cosine
from nodes.stability.landing_proof import law_polynomials
from nodes.stability.plant import Plant, held_plant
from sim.arrays import Array


@dataclass(frozen=True)
class Surroundings:
    """Conditions under which a law must be stable, with any passive world within the tick."""

    period: float  # sampling period T [s]
    damping: float  # viscous damping b of the device, minimum [N s/m]
    delay: tuple[float, float]  # shortest and longest delay of the loop [ticks]
    nyquist: float  # largest |H(−1)| allowed [N/m]
    # lightest and heaviest device [kg]; None for any hand, of any mass
    mass: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if not self.damping > 0.0:
            raise ValueError(
                f"damping = {self.damping!r} N s/m: without damping nothing is stable for any world"
            )

    @property
    def limit(self) -> float:
        """Return 2b/(T(1 + d)), the limit of any causal linear law for any hand [N/m].

        d is the longest delay.
        """
        return 2.0 * self.damping / (self.period * (1.0 + self.delay[1]))

    def conditions(self, masses: int) -> list["Requirement"]:
        """Return the requirements to meet.

        For any hand: at the ends and whole ticks of the delay; for a known device: at some masses
        and delays.
        """
        low, high = self.delay
        whole = np.arange(math.ceil(low), math.floor(high) + 1).tolist()
        if self.mass is None:
            # r is linear in the fraction of a tick: between two whole delays the ends are the
            # worst.
            return [_any_hand(self, delay) for delay in sorted({low, high, *whole})]
        delays = sorted({*np.linspace(low, high, 5).tolist(), *whole})
        return [
            _known(self, mass, delay)
            for mass in np.unique(np.geomspace(*self.mass, masses)).tolist()
            for delay in delays
        ]


@dataclass(frozen=True)
class Requirement:
    """The condition 2 weight Re{H/(1 − w)}/T + rest |H|² > 0 at every θ.

    weight (≥ 0) and rest [s/kg] are cosine sums.
    """

    period: float
    weight: Array
    rest: Array

    def margin(self, law: CompiledLaw) -> Array:
        """Return the cosine sum that is positive wherever the condition is met."""
        top, bottom = law_polynomials(law)
        linear = 2.0 / self.period * (top * bottom.conjugate).real_over_one_less_w()
        return _sum(
            _product(self.weight, linear),
            _product(self.rest, (top * top.conjugate).real()),
        )


@dataclass(frozen=True)
class WorldDesign:
    """The stiffest law of a family for any world."""

    taps: Array  # numerator h_0 … h_n [N/m], shape (n + 1,)
    bottom: Array  # denominator in w, 1 for taps alone, shape (1,) to (3,)
    parameters: Array  # weights of the family's basis, shape (p,)
    h1_n_per_m: float  # H(1) [N/m]
    h_nyquist_n_per_m: float  # H(−1) [N/m]
    limit_n_per_m: float  # the closed limit for any hand, 2b/(T(1 + d)) [N/m]
    # upper bound for the family; None for a known device [N/m]
    bound_n_per_m: float | None
    # whether the condition is met at every frequency, and H has no zero outside the unit circle
    proven: bool

    @property
    def law(self) -> CompiledLaw:
        """Return the law as the coupling renders it."""
        return over(self.taps, self.bottom)


def behind_poles(*poles: complex) -> Array:
    """Return the denominator Π (1 − pole·w) of up to two poles, real or conjugate."""
    return np.trim_zeros(np.real(np.poly(poles)), "b") if poles else np.ones(1)


def over(taps: Array, bottom: Array) -> CompiledLaw:
    """Compile h_0 … h_n over 1 + a1·w + a2·w²: taps and one section for the remainder.

    Parameters
    ----------
    taps : ndarray, shape (n + 1,)
        The numerator in w [N/m].
    bottom : ndarray, shape (1,) to (3,)
        The denominator in w, its first number 1.
    """
    bottom = np.trim_zeros(bottom, "b")
    if len(bottom) == 1:
        return CompiledLaw(tuple(taps.tolist()))
    # N(w) = P(w) Q(w) + R(w): the remainder is the section's numerator.
    quotient, left = np.polydiv(taps[::-1], bottom[::-1])
    b0, b1 = (*left[::-1].tolist(), 0.0)[:2]
    a1, a2 = (*bottom[1:].tolist(), 0.0)[:2]
    newest = quotient[::-1] if len(taps) >= len(bottom) else np.zeros(1)
    return CompiledLaw(tuple(newest.tolist()), ((b0, b1, a1, a2),))


def _any_hand(surroundings: Surroundings, delay: float) -> Requirement:
    """Set r = [1 − (1−φ) cos((1+i)θ) − φ cos((2+i)θ)]/(2b), over 1 − cos θ."""
    whole = math.floor(delay)
    fraction = delay - whole
    rest = (1.0 - fraction) * np.append(
        one_less_cosine(1 + whole), 0.0
    ) + fraction * one_less_cosine(2 + whole)
    return Requirement(
        surroundings.period, np.array([1.0]), -rest / (2.0 * surroundings.damping)
    )


def _known(surroundings: Surroundings, mass: float, delay: float) -> Requirement:
    """Return the requirement of a known device: r = −Re{D P_d}.

    Both sides are multiplied by |1 − w e|² / (1 − cos θ) of its own denominator.
    """
    held = held_plant(Plant(surroundings.period, mass, surroundings.damping, delay))
    own = Laurent(np.cumsum(held.denominator)[:-1])  # the denominator without 1 − w
    path = Laurent(np.array(held.numerator), held.whole + 1)
    size = (own * own.conjugate).real()
    weight = _product(np.array([1.0, -1.0]), size)
    return Requirement(
        surroundings.period, weight, (path * own.conjugate).real() / surroundings.period
    )


def _product(a: Array, b: Array) -> Array:
    """Return the product of two cosine sums."""
    long = len(a) + len(b) - 1
    total = np.zeros(long)
    for i, one in enumerate(a.tolist()):
        for j, other in enumerate(b.tolist()):
            total[i + j] += 0.5 * one * other
            total[abs(i - j)] += 0.5 * one * other
    return total


def _sum(a: Array, b: Array) -> Array:
    total = np.zeros(max(len(a), len(b)))
    total[: len(a)] += a
    total[: len(b)] += b
    return total
