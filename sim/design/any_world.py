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
from typing import Any

import numpy as np

from nodes.laws import CompiledLaw
from nodes.stability.closed_loop import pole_radius
from nodes.stability.cosine_sums import Laurent, positive, values
from nodes.stability.landing_proof import law_polynomials
from nodes.stability.plant import Plant
from sim.arrays import Array
from sim.design.demand import alternating
from sim.design.surroundings import Requirement, Surroundings, WorldDesign, over

_CUTS = 80
# distance of a design from the condition, as a share of its taps: margin for the proof's rounding
_INSIDE = 1e-7
_LARGEST = 1e6  # largest tap, in units of b/T
# least share between the smallest and the largest scale of a shape; a design is shrunk within it
_WINDOW = 2e-3


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
        # of the numerator, (t, p)
        self.response = np.array([row.at(theta) for row in rows]).T
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
