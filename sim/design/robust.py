"""The stiffest law of a family whose pole radius stays below a bound over ranges of mass, delay and hand.

A family is linear in its parameters: all taps free, or spring and one derivative part (PD, one PDα, the paper's optimum at
free gain). So all of them go through the same search and can be compared. The search is global first (differential
evolution with a fixed seed), then a sequence of linear programmes: every pole near the bound is linearised in the taps, the
programme raises H(1) within a trust region, and what came out is accepted only if its true poles keep the bound. Cases
between those of the search are checked afterwards, and the worst one joins it until none is worse.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nodes.stability.held_plant import held_plant
from nodes.stability.roots import largest_roots

__all__ = [
    "Demand",
    "Robust",
    "Vector",
    "stiffest",
    "verified_cases",
]

Vector = NDArray[np.float64]

_MASSES = 5
_VERIFIED = 801


@dataclass(frozen=True)
class Demand:
    """What a law must keep, whatever its stiffness.

    Attributes
    ----------
    mass : tuple of float, shape (2,)
        Lightest and heaviest device, a hand's share included [kg].
    damping : float
        Viscous damping b of the device, the least of it where it is a range [N s/m].
    delay : tuple of float, shape (2,)
        Shortest and longest delay of the loop, fractions allowed [ticks].
    period : float
        Sampling period T [s].
    radius : float
        Largest pole radius R allowed at any mass, delay and hand of the ranges.
    nyquist : float
        Largest |H(−1)| allowed [N/m].
    stiffness : tuple of float, shape (2,)
        Softest and stiffest hand [N/m].
    damping_max : float or None
        Most damping of the device; None where it is known [N s/m].
    """

    mass: tuple[float, float]
    damping: float
    delay: tuple[float, float]
    period: float
    radius: float
    nyquist: float
    stiffness: tuple[float, float] = (0.0, 0.0)
    damping_max: float | None = None

    @property
    def dampings(self) -> tuple[float, float]:
        """Least and most damping of the device [N s/m]."""
        return self.damping, self.damping if self.damping_max is None else self.damping_max


@dataclass(frozen=True)
class Robust:
    """The stiffest law found in a family.

    Attributes
    ----------
    taps : ndarray, shape (n + 1,)
        h_0 ... h_n [N/m].
    parameters : ndarray, shape (p,)
        Weights of the family's basis.
    h1_n_per_m : float
        H(1) [N/m].
    h_nyquist_n_per_m : float
        H(−1) [N/m].
    radius : float
        Largest pole radius over all verified cases.
    worst : tuple of float, shape (4,)
        The case where that is: mass [kg], delay [ticks], stiffness of the hand [N/m], damping of the device [N s/m].
    """

    taps: Vector
    parameters: Vector
    h1_n_per_m: float
    h_nyquist_n_per_m: float
    radius: float
    worst: tuple[float, ...]


class _Loop:
    """Closed-loop polynomials at given cases (mass, delay, hand), linear in the taps."""

    def __init__(self, demand: Demand, cases: Vector, taps: int) -> None:
        plants = [held_plant(mass, b, demand.period, delay, hand) for mass, delay, hand, b in cases.tolist()]
        # A shorter delay is the same polynomial times a power of z: roots at zero that nobody minds.
        size = max(plant.whole for plant in plants) + 3 + taps
        self.taps = taps
        self.fixed = np.zeros((len(plants), size))
        self.by_tap = np.zeros((len(plants), taps, size))
        for i, plant in enumerate(plants):
            self.fixed[i, :3] = plant.denominator
            for j in range(taps):
                start = plant.whole + 1 + j
                self.by_tap[i, j, start : start + 3] = plant.numerator

    def polynomials(self, taps: Vector) -> Vector:
        """Coefficients of (..., taps) for every case: (..., cases, size)."""
        return np.asarray(self.fixed + np.einsum("...j,ijk->...ik", taps, self.by_tap), dtype=np.float64)

    def radii(self, taps: Vector) -> Vector:
        return largest_roots(self.polynomials(taps))

    def poles(self, taps: Vector) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
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


def stiffest(
    demand: Demand,
    basis: Vector,
    free: bool = True,
    seed: int = 1,
    effort: int = 1,
    known: Sequence[Vector] = (),
) -> Robust | None:
    """Find the law of a family with the largest H(1) that keeps the demand.

    Parameters
    ----------
    demand : Demand
        Mass range, delay, pole radius and bound on H(−1).
    basis : ndarray, shape (p, n + 1)
        Taps per unit of each parameter [N/m]; any scaling.
    free : bool
        Whether parameters may be negative, as taps may; a named law's stiffness and damping may not.
    seed : int
        Of the global search.
    effort : int
        Multiplies the generations of the global search.
    known : sequence of ndarray, shape (p,)
        Parameters of members that keep the demand, e.g. of a shorter law: the search climbs from them too.

    Returns
    -------
    Robust or None
        None when no member of the family keeps the demand.
    """
    basis = np.asarray(basis, dtype=np.float64)
    # One unit of each parameter: a force that moves the lightest device by the deflection within one tick.
    scale = demand.mass[0] / demand.period**2 / np.abs(basis).max(axis=1)
    basis = basis * scale[:, None]
    cases, everywhere = _cases(demand, _MASSES, 3), verified_cases(demand)
    fine = _Loop(demand, everywhere, basis.shape[1])
    # A hair inside, so that rounding of the printed taps cannot cross the bound.
    target = demand.radius - 1e-9
    starts = [np.asarray(start, dtype=np.float64) / scale for start in known]
    best = max(
        (start for start in starts if _keeps(demand, basis, fine, start)),
        key=lambda start: float(start @ basis.sum(axis=1)),
        default=None,
    )
    for start in [*starts, *_global(demand, basis, cases, free, seed, effort)]:
        found = _settle(demand, basis, fine, everywhere, cases, start, target, free)
        if found is not None and (best is None or found @ basis.sum(axis=1) > best @ basis.sum(axis=1)):
            best = found
    if best is None:
        return None
    taps = best @ basis
    radii = fine.radii(taps)
    worst = int(np.argmax(radii))
    return Robust(
        taps=taps,
        parameters=best * scale,
        h1_n_per_m=float(taps.sum()),
        h_nyquist_n_per_m=float(taps @ _alternating(taps.size)),
        radius=float(radii[worst]),
        worst=tuple(everywhere[worst].tolist()),
    )


def verified_cases(demand: Demand) -> Vector:
    """Cases on which a design is verified after the search.

    Parameters
    ----------
    demand : Demand
        With the ranges.

    Returns
    -------
    ndarray, shape (c, 4)
        Mass [kg], delay [ticks], stiffness of the hand [N/m], damping of the device [N s/m]: 801 masses evenly spaced in the
        logarithm, or 101 masses with 11 delays and hands and 5 dampings where those are ranges too; all ends are among them.
    """
    ranges = (demand.delay, demand.stiffness, demand.dampings)
    return _cases(demand, 101 if any(low < high for low, high in ranges) else _VERIFIED, 11)


def _cases(demand: Demand, masses: int, others: int) -> Vector:
    axes = [
        np.geomspace(*demand.mass, masses) if demand.mass[0] < demand.mass[1] else np.array(demand.mass[:1]),
        np.linspace(*demand.delay, others) if demand.delay[0] < demand.delay[1] else np.array(demand.delay[:1]),
        np.linspace(*demand.stiffness, others)
        if demand.stiffness[0] < demand.stiffness[1]
        else np.array(demand.stiffness[:1]),
        np.linspace(*demand.dampings, min(others, 5)) if demand.damping_max is not None else np.array([demand.damping]),
    ]
    return np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")], axis=1)


def _settle(
    demand: Demand,
    basis: Vector,
    fine: _Loop,
    everywhere: Vector,
    cases: Vector,
    start: Vector,
    target: float,
    free: bool,
) -> Vector | None:
    """Climb, verify everywhere, take the worst case in and come back inside, until there is none."""
    here = start
    for _ in range(12):
        here = _climb(demand, basis, _Loop(demand, cases, fine.taps), here, target, free)
        radii = fine.radii(here @ basis)
        worst = int(np.argmax(radii))
        if radii[worst] <= demand.radius:
            return here if _quiet(demand, basis, here) else None
        cases = np.vstack([cases, everywhere[worst]])
        here = _retreat(demand, basis, _Loop(demand, cases, fine.taps), here, target, free)
    return None


def _keeps(demand: Demand, basis: Vector, fine: _Loop, parameters: Vector) -> bool:
    return _quiet(demand, basis, parameters) and float(fine.radii(parameters @ basis).max()) <= demand.radius


def _quiet(demand: Demand, basis: Vector, parameters: Vector) -> bool:
    return abs(float(parameters @ basis @ _alternating(basis.shape[1]))) <= demand.nyquist * (1.0 + 1e-12)


def _alternating(size: int) -> Vector:
    return np.asarray(np.where(np.arange(size) % 2, -1.0, 1.0), dtype=np.float64)


def _global(demand: Demand, basis: Vector, cases: Vector, free: bool, seed: int, effort: int) -> list[Vector]:
    """Feasible starts in different corners: narrow and wide boxes, each with its own seed."""
    from scipy.optimize import Bounds, differential_evolution

    loop = _Loop(demand, cases, basis.shape[1])
    signs = _alternating(basis.shape[1])
    unit = demand.mass[0] / demand.period**2

    def score(columns: Vector, /) -> Any:
        taps = columns.T @ basis
        excess = np.maximum(loop.radii(taps).max(axis=-1) - demand.radius, 0.0)
        noise = np.maximum(np.abs(taps @ signs) - demand.nyquist, 0.0) / unit
        outside = excess + noise
        # Feasible ones compete by H(1), the others by how far they are from feasible; none of them can win.
        return np.asarray(np.where(outside > 0.0, 1.0 + 10.0 * outside, -taps.sum(axis=1) / unit), dtype=np.float64)

    p = basis.shape[0]
    starts = []
    # Many parameters have many local optima: more starts where there are more of them.
    for i, span in enumerate((0.3, 3.0) * (1 if p <= 4 else 2)):
        result = differential_evolution(
            score,
            Bounds([-span if free else 0.0] * p, [span] * p),
            maxiter=(40 + 40 * p) * effort,
            popsize=12,
            rng=seed + i,
            tol=1e-8,
            polish=False,
            vectorized=True,
            updating="deferred",
        )
        if float(result.fun) < 0.0:
            starts.append(np.asarray(result.x, dtype=np.float64))
    return starts


def _climb(demand: Demand, basis: Vector, loop: _Loop, start: Vector, target: float, free: bool) -> Vector:
    """Raise H(1) by linear programmes over the linearised poles, never leaving the bound."""
    from scipy.optimize import linprog

    signs = _alternating(basis.shape[1])
    gain, noise = basis.sum(axis=1), basis @ signs
    here, trust = start, 0.05
    for _ in range(300):
        if trust < 1e-9:
            break
        poles, slopes = loop.poles(here @ basis)
        size = np.abs(poles)
        near = size > target - 0.05 - 3.0 * trust
        along = (np.conj(poles)[..., None] * slopes).real / np.maximum(size, 1e-12)[..., None]
        rows = along[near] @ basis.T
        limits = target - size[near]
        rows = np.vstack([rows, noise, -noise])
        limits = np.concatenate([limits, [demand.nyquist - noise @ here, demand.nyquist + noise @ here]])
        # A start on the bound may be beyond it by a rounding.
        bounds = [(-trust if free else max(-trust, -at), trust) for at in here.tolist()]
        solution = linprog(-gain, A_ub=rows, b_ub=np.maximum(limits, 0.0), bounds=bounds)
        if not solution.success or solution.x is None:
            trust *= 0.25
            continue
        there = here + solution.x
        gained = float(gain @ solution.x)
        if gained > 0.0 and _quiet(demand, basis, there) and float(loop.radii(there @ basis).max()) <= target:
            if gained < 1e-10 * float(gain @ here):
                break
            here, trust = there, min(2.0 * trust, 0.5)
            continue
        # Back towards where it was: often half of the step keeps the bound.
        for part in (0.5, 0.25):
            between = here + part * solution.x
            inside = float(loop.radii(between @ basis).max()) <= target
            if inside and gained > 0.0 and _quiet(demand, basis, between):
                here = between
                break
        trust *= 0.4
    return here


def _retreat(demand: Demand, basis: Vector, loop: _Loop, start: Vector, target: float, free: bool) -> Vector:
    """Bring a law back inside after a case has joined: to where the excess is least, then back as far as allowed."""
    from scipy.optimize import minimize

    signs = _alternating(basis.shape[1])

    def excess(p: Vector) -> float:
        if not free and p.min() < 0.0:
            return 1e3
        noise = max(abs(float(p @ basis @ signs)) / demand.nyquist - 1.0, 0.0)
        return float(loop.radii(p @ basis).max()) - target + noise

    if excess(start) <= 0.0:
        return start
    found = minimize(excess, start, method="Nelder-Mead", options={"maxfev": 1500, "xatol": 1e-10, "fatol": 1e-12})
    inner = np.asarray(found.x, dtype=np.float64)
    if excess(inner) > 0.0:
        return inner
    low, high = 0.0, 1.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if excess(inner + middle * (start - inner)) <= 0.0 else (low, middle)
    return inner + low * (start - inner)
