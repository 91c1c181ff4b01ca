"""The stiffest law that is stable for any passive world, with any hand or a known device.

A wall is not the worst world (THEORY.md §18, §20). With D = (1 − w)/T the loop is stable for every
passive world that answers within the tick iff Re{D/H} > r(θ); r belongs to the known device, or is
the maximum over all hands. This is Re{D* H} > r |H|², convex in the taps for r ≥ 0, which holds for
any hand: cutting planes find the stiffest taps of a family and an upper bound. For a known device r
< 0 where the device itself dissipates; there each *shape* of a law has its largest scale in closed
form, and the shapes are searched.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from nodes.laws import CompiledLaw
from nodes.stability.closed_loop import pole_radius
from nodes.stability.cosine_sums import Laurent, one_less_cosine, positive, values
from nodes.stability.landing_proof import law_polynomials
from nodes.stability.plant import Plant, held_plant
from sim.arrays import Array
from sim.design.demand import alternating

_CUTS = 80
# distance of a design from the condition, as a share of its taps: margin for the proof's rounding
_INSIDE = 1e-7
_LARGEST = 1e6  # largest tap, in units of b/T
# least share between the smallest and the largest scale of a shape; a design is shrunk within it
_WINDOW = 2e-3


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
    bound_n_per_m: (
        float | None
    )  # upper bound for the family; None for a known device [N/m]
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


def stiffest_for_any_world(
    surroundings: Surroundings,
    basis: Array,
    free: bool = True,
    bottom: Array | None = None,
    masses: int = 7,
) -> WorldDesign | None:
    """Find the member of a family with the largest H(1) stable for any world, or None.

    basis: rows whose sum, weighted by the parameters, is the numerator, shape (p, n + 1) [N/m per
        parameter].
    free: parameters may be negative.
    bottom: denominator of a section behind them (`behind_poles`).
    masses: number of masses of the range that are checked.
    """
    conditions = surroundings.conditions(masses)
    below = np.ones(1) if bottom is None else bottom
    if surroundings.mass is None:
        return _convex(surroundings, conditions, basis, free, below)
    return _for_device(surroundings, conditions, basis, free, below)


class _Table:
    """Terms of all conditions over a grid of angles, linear in a family's parameters."""

    def __init__(
        self,
        conditions: Sequence[Requirement],
        basis: Array,
        bottom: Array,
        fineness: int = 64,
    ) -> None:
        size = fineness * (basis.shape[1] + 4)
        # A slow pole makes narrow dips far below ω_N.
        low = size if len(bottom) == 1 else 6 * size
        theta = np.union1d(
            np.linspace(0.0, np.pi, size + 1), np.geomspace(1e-3, np.pi, low)
        )
        below = Laurent(bottom)
        rows = [Laurent(row) for row in basis]
        linear = np.array(
            [
                values((row * below.conjugate).real_over_one_less_w(), theta)
                for row in rows
            ]
        ).T
        self.response = np.array(
            [row.at(theta) for row in rows]
        ).T  # of the numerator, (t, p)
        period = conditions[0].period
        weights = [values(one.weight, theta) for one in conditions]
        rests = [values(one.rest, theta) for one in conditions]
        self.linear = np.concatenate(
            [2.0 / period * weight[:, None] * linear for weight in weights]
        )
        self.rest = np.concatenate(rests)
        self.response = np.tile(self.response, (len(conditions), 1))

    def parts(self, parameters: Array) -> tuple[Array, Array, Array]:
        """Return the linear part, rest |N|², and the gradient of the latter by the parameters."""
        response = self.response @ parameters
        square = self.rest * np.abs(response) ** 2
        slopes = (
            2.0 * self.rest[:, None] * (np.conj(response)[:, None] * self.response).real
        )
        return self.linear @ parameters, square, slopes


def _convex(
    surroundings: Surroundings,
    conditions: Sequence[Requirement],
    basis: Array,
    free: bool,
    bottom: Array,
) -> WorldDesign | None:
    """Search by cutting planes for any hand, where the condition is convex: rest ≤ 0."""
    from scipy.optimize import linprog

    table = _Table(conditions, basis, bottom)
    unit = surroundings.damping / surroundings.period
    gain = basis.sum(axis=1) / bottom.sum()
    noise = basis @ alternating(basis.shape[1]) / (bottom @ alternating(len(bottom)))
    # scale of a parameter, so that its taps are about b/T
    scale = unit / np.maximum(np.abs(basis).max(axis=1), 1e-300)
    rows = [noise * scale, -noise * scale, gain * scale]
    limits = [surroundings.nyquist] * 2 + [surroundings.limit * 1.5]
    bounds = [(-_LARGEST if free else 0.0, _LARGEST)] * len(basis)
    best = None
    most = 0.0
    bound = math.inf
    # Re{H/(1 − w)} ≥ 0 is necessary: at a few frequencies it keeps the first programs bounded.
    few = table.linear[::16]
    rows = [*rows, *(-few * scale)]
    limits = [*limits, *np.zeros(len(few))]
    for _ in range(_CUTS):
        found = linprog(
            -gain * scale, A_ub=np.array(rows), b_ub=np.array(limits), bounds=bounds
        )
        if not found.success or found.x is None:
            break
        here = np.asarray(found.x, dtype=np.float64) * scale
        bound = min(bound, float(gain @ here))
        linear, square, slopes = table.parts(here)
        # Scaled by s the linear part grows with s, the rest with s²: s is limited by the worst
        # angle.
        with np.errstate(divide="ignore", invalid="ignore"):
            shrink = np.where(square < 0.0, linear / -square, np.inf)
        factor = min(1.0, float(shrink.min()))
        if factor * float(gain @ here) > most:
            best = factor * here
            most = factor * float(gain @ here)
        if most >= bound * (1.0 - 1e-7):
            break
        excess = -(linear + square)
        padded = np.concatenate([[-np.inf], excess, [-np.inf]])
        peaks = np.flatnonzero(
            (excess >= padded[:-2]) & (excess >= padded[2:]) & (excess > 0.0)
        )
        # linear + square(here) + slopes (p − here) ≥ 0, and square(p) ≤ its tangent.
        rows += list(-(table.linear[peaks] + slopes[peaks]) * scale)
        limits += list(square[peaks] - slopes[peaks] @ here)
    return None if best is None else _finished(surroundings, best, basis, bottom, bound)


def _for_device(
    surroundings: Surroundings,
    conditions: Sequence[Requirement],
    basis: Array,
    free: bool,
    bottom: Array,
) -> WorldDesign | None:
    """Search the shapes of a family, with H(1) = 1; each has its largest scale in closed form."""
    from scipy.optimize import differential_evolution, minimize

    coarse = _Table(conditions, basis, bottom, 8)
    table = _Table(conditions, basis, bottom)
    gain = basis.sum(axis=1) / bottom.sum()
    noise = basis @ alternating(basis.shape[1]) / (bottom @ alternating(len(bottom)))
    size = np.maximum(np.abs(basis).max(axis=1), 1e-300)

    def shape(free_ones: Array) -> Array | None:
        """Return parameters with H(1) = 1; the first follows from the others."""
        others = free_ones / size[1:]
        first = (1.0 - gain[1:] @ others) / gain[0]
        return None if not free and first < 0.0 else np.append(first, others)

    def less_stiffness(free_ones: Array, grid: _Table) -> float:
        parameters = shape(np.asarray(free_ones))
        if parameters is None:
            return 1.0
        stiffest, shortfall = _largest_scale(grid, parameters)
        stiffest = min(
            stiffest, surroundings.nyquist / max(abs(float(noise @ parameters)), 1e-300)
        )
        if shortfall > 0.0 or not zeros_inside(over(parameters @ basis, bottom)):
            return 1.0 + min(shortfall, 1e3)
        return -stiffest / surroundings.limit

    if len(basis) == 1:
        best = np.zeros(0)
    else:
        box: Any = [(-6.0 if free else 0.0, 12.0)] * (len(basis) - 1)
        found = differential_evolution(
            less_stiffness,
            box,
            args=(coarse,),
            rng=0,
            popsize=8,
            maxiter=25 * len(basis),
            tol=1e-5,
            polish=False,
        )
        options: Any = {"maxiter": 150 * len(basis), "xatol": 1e-8, "fatol": 1e-9}
        polished = minimize(
            less_stiffness,
            found.x,
            args=(table,),
            method="Nelder-Mead",
            options=options,
        )
        best = np.asarray(polished.x, dtype=np.float64)
    value = less_stiffness(best, table)
    parameters = shape(best)
    if value >= 0.0 or parameters is None:
        return None
    return _finished(
        surroundings, parameters * -value * surroundings.limit, basis, bottom, None
    )


def _largest_scale(table: _Table, parameters: Array) -> tuple[float, float]:
    """Return the largest factor of a shape at all angles, and its relative shortfall.

    The shortfall is relative to the smallest factor required, which must leave a window.
    """
    linear, square, _ = table.parts(parameters)
    against = square < 0.0
    with_it = square > 0.0
    high = float(np.min(linear[against] / -square[against], initial=np.inf))
    low = float(np.max(-linear[with_it] / square[with_it], initial=0.0))
    if not high > 0.0:
        return 0.0, 1e3
    return high, max(0.0, low / (high * (1.0 - _WINDOW)) - 1.0)


def zeros_inside(law: CompiledLaw) -> bool:
    """Check that H has no zero in |z| ≥ 1, so that its inverse is stable.

    Otherwise a world could oscillate while the force is zero.
    """
    top, _ = law_polynomials(law)
    zeros = np.roots(top.coefficients)
    return not len(zeros) or float(np.abs(zeros).max()) < 1.0


def _finished(
    surroundings: Surroundings,
    parameters: Array,
    basis: Array,
    bottom: Array,
    bound: float | None,
) -> WorldDesign | None:
    """Shrink a design slightly for rounding, and prove it at every frequency."""
    inside = parameters
    proven = False
    for shrink in (_INSIDE, 1e-5, 1e-4, 1e-3):
        inside = parameters * (1.0 - shrink)
        proven = keeps(surroundings, over(inside @ basis, bottom))
        if proven:
            break
    taps = inside @ basis
    law = over(taps, bottom)
    if not law.h1 > 0.0:
        return None
    return WorldDesign(
        taps, bottom, inside, law.h1, law.h_nyquist, surroundings.limit, bound, proven
    )


def keeps(surroundings: Surroundings, law: CompiledLaw, masses: int = 15) -> bool:
    """Check that a law is stable for any world: proven at every frequency.

    For any hand this holds at all delays. For a known device it is proven at `masses` of the range
    and five delays, and the loop at the wall is checked there too.
    """
    if not (law.h1 > 0.0 and law.stable_sections() and zeros_inside(law)):
        return False
    if surroundings.mass is not None:
        for mass in np.unique(np.geomspace(*surroundings.mass, masses)).tolist():
            for delay in sorted(set(surroundings.delay)):
                if (
                    not pole_radius(
                        law,
                        Plant(surroundings.period, mass, surroundings.damping, delay),
                    )
                    < 1.0
                ):
                    return False
    return all(
        positive(condition.margin(law)) is True
        for condition in surroundings.conditions(masses)
    )


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
