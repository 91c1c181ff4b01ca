"""The stiffest law with bounded pole radius over ranges of mass, delay and hand.

A family is linear in its parameters: all taps free, or a spring and one derivative part (PD, one
PDα, the paper's optimum). All families use the same search: differential evolution with fixed seeds
(`sim.design.evolution`), then linear programs. Each of these linearises the poles near the bound in
the taps and raises H(1) within a trust region; the step is accepted only if the exact poles stay
within the bound. The worst case between the searched cases is added until none is worse.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sim.arrays import Array
from sim.design.demand import (
    Demand,
    LoopCase,
    Robust,
    alternating,
    cases_of,
    filtered,
    verified_cases,
)
from sim.design.evolution import evolved
from sim.design.landing import landed
from sim.design.linear_family import LinearFamily
from sim.measure.cancelling import check

_MASSES = 5
# Half-widths of the boxes searched without a start: a narrow box alone excludes the stiffest long
# laws.
_SPANS = (0.3, 10.0)


def stiffest(
    demand: Demand,
    basis: Array,
    free: bool = True,
    seed: int = 1,
    effort: int = 1,
    known: Sequence[Array] = (),
    pole: float = 0.0,
) -> Robust | None:
    """Find the law of a family with the largest H(1) that meets the demand, or None.

    basis: taps per unit of each parameter [N/m], shape (p, n + 1).
    free: parameters may be negative.
    effort: factor on the generations of the global search.
    known: members to start from as well, such as a shorter law, each of shape (p,).
    pole: pole of the filter behind two taps; 0: none.
    """
    basis = np.asarray(basis, dtype=np.float64)
    # One unit of each parameter: a force that moves the lightest device by the deflection within
    # one tick.
    scale = demand.mass[0] / demand.period**2 / np.abs(basis).max(axis=1)
    basis = basis * scale[:, None]
    # With a filter, taps may have (1 + pole) times the gain at ω_N and give 1/(1 − pole) times the
    # stiffness.
    asked = replace(demand, nyquist=demand.nyquist * (1.0 + pole))
    everywhere = verified_cases(demand)
    fine = LoopCase(demand, everywhere, basis.shape[1], pole)
    starts = [np.asarray(start, dtype=np.float64) / scale for start in known]
    family = LinearFamily(asked, basis, fine, free, seed, effort)
    best = (landed if demand.lands else _climbed)(family, starts)
    if best is None:
        return None
    taps = best @ basis
    radii = fine.radii(taps)
    worst = int(np.argmax(radii))
    law = filtered(taps, pole)
    case = tuple(everywhere[worst].tolist())
    return Robust(
        taps, best * scale, law.h1, law.h_nyquist, float(radii[worst]), case, pole
    )


def _climbed(family: LinearFamily, starts: list[Array]) -> Array | None:
    """Climb from all starts by linear programs."""
    # Slightly inside, so that rounding of the printed taps cannot cross the bound.
    target = family.demand.radius - 1e-9
    tried = [*starts, *_global(family, target)]
    best = max(filter(family.keeps, tried), key=family.stiffness, default=None)
    for start in tried:
        found = _settle(family, start, target)
        if found is not None and (
            best is None or family.stiffness(found) > family.stiffness(best)
        ):
            best = found
    return best


def _settle(family: LinearFamily, start: Array, target: float) -> Array | None:
    """Climb, verify everywhere, add the worst case and return inside, until none is worse."""
    here = start
    cases = cases_of(family.demand, _MASSES, 3)
    everywhere = verified_cases(family.demand)
    for _ in range(12):
        here = _climb(family, family.loop(cases), here, target)
        radii = family.fine.radii(here @ family.basis)
        worst = int(np.argmax(radii))
        if radii[worst] <= family.demand.radius:
            return here if family.is_quiet(here) else None
        cases = np.vstack([cases, everywhere[worst]])
        here = _retreat(family, family.loop(cases), here, target)
    return None


def _global(family: LinearFamily, target: float) -> list[Array]:
    """Return feasible starts, stiffest first, each from its own seed."""
    p, fine = len(family.basis), family.fine
    few, many = (
        family.loop(cases_of(family.demand, masses, 3)) for masses in (15, 101)
    )
    # Ranges of delay and hand give thousands of cases; the climb then brings the start inside all
    # of them.
    loops = (few, many, fine) if len(fine.fixed) <= 1000 else (few, few, many)
    spans = _SPANS if p <= 4 else _SPANS[1:] * 2
    tried = [
        evolved(replace(family, seed=family.seed + i), loops, span, target)
        for i, span in enumerate(spans)
    ]
    found = [one for one in tried if one is not None]
    return sorted(found, key=family.stiffness, reverse=True)


def _climb(family: LinearFamily, loop: LoopCase, start: Array, target: float) -> Array:
    """Raise H(1) by linear programs over the linearised poles without leaving the bound."""
    from scipy.optimize import linprog

    basis, gain, noise = family.basis, family.gain, family.noise
    bound = family.demand.nyquist
    here = start
    trust = 0.05
    for _ in range(300):
        check()
        if trust < 1e-9:
            break
        poles, slopes = loop.poles(here @ basis)
        size = np.abs(poles)
        near = size > target - 0.05 - 3.0 * trust
        along = (np.conj(poles)[..., None] * slopes).real / np.maximum(size, 1e-12)[
            ..., None
        ]
        rows = np.vstack([along[near] @ basis.T, noise, -noise])
        quiet = [bound - noise @ here, bound + noise @ here]
        limits = np.concatenate([target - size[near], quiet])
        # A start on the bound may exceed it by a rounding error.
        bounds = [
            (-trust if family.free else max(-trust, -at), trust) for at in here.tolist()
        ]
        solution = linprog(
            -gain, A_ub=rows, b_ub=np.maximum(limits, 0.0), bounds=bounds
        )
        if not solution.success or solution.x is None:
            trust *= 0.25
            continue
        there = here + solution.x
        gained = float(gain @ solution.x)
        if (
            gained > 0.0
            and family.is_quiet(there)
            and float(loop.radii(there @ basis).max()) <= target
        ):
            if gained < 1e-10 * float(gain @ here):
                break
            here = there
            trust = min(2.0 * trust, 0.5)
            continue
        # Step back: often half of the step stays within the bound.
        for part in (0.5, 0.25):
            between = here + part * solution.x
            inside = float(loop.radii(between @ basis).max()) <= target
            if inside and gained > 0.0 and family.is_quiet(between):
                here = between
                break
        trust *= 0.4
    return here


def _retreat(
    family: LinearFamily, loop: LoopCase, start: Array, target: float
) -> Array:
    """Return a law to the inside of the bound after a case was added.

    Minimise the excess first, then go back towards the start as far as the bound allows.
    """
    from scipy.optimize import minimize

    basis, signs = family.basis, alternating(family.basis.shape[1])

    def excess(p: Array) -> float:
        if not family.free and p.min() < 0.0:
            return 1e3
        noise = max(abs(float(p @ basis @ signs)) / family.demand.nyquist - 1.0, 0.0)
        return float(loop.radii(p @ basis).max()) - target + noise

    if excess(start) <= 0.0:
        return start
    found = minimize(
        excess,
        start,
        method="Nelder-Mead",
        options={"maxfev": 1500, "xatol": 1e-10, "fatol": 1e-12},
    )
    inner = np.asarray(found.x, dtype=np.float64)
    if excess(inner) > 0.0:
        return inner
    low, high = 0.0, 1.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (
            (middle, high)
            if excess(inner + middle * (start - inner)) <= 0.0
            else (low, middle)
        )
    return inner + low * (start - inner)
