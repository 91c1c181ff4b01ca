"""Shaping f(ω) without descent: for fixed orders f is linear in the gains.

So the best gains are a least-squares or a linear-programming problem with one answer, and only the orders are left to
search. What the gains may not do here is pass a negative spring off as damping: f is that of D − D(1), whose mean is zero.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from sim.arrays import Array
from sim.paper.descent import Targets, damping_curve, term_damping


@dataclass(frozen=True)
class Shaping:
    """Gains and orders of a multi-term law and the f they give, all normalised (T = 2), the spring taken as H(1)."""

    # A_i and α_i, shape (t,).
    gains: Array
    orders: Array
    ripple: float  # largest |f + 1| over the band
    nyquist: float  # f(ω_N)


def least_squares(orders: Array, targets: Targets, taps: int) -> Array:
    """Gains with the least cost (13) for given orders; of several, the shortest."""
    basis = np.array([term_damping(targets.theta, order, taps)[0] for order in orders.tolist()])
    gains, *_ = np.linalg.lstsq(basis.T, targets.value, rcond=None)
    return np.asarray(gains, dtype=np.float64)


def minimax(orders: Array, band: tuple[float, float], nyquist: float, taps: int, points: int = 61) -> Shaping | None:
    """Gains with the least ripple about f = −1 over a band, f(ω_N) bounded: a linear programme."""
    from scipy.optimize import linprog

    theta = np.pi * np.linspace(band[0], band[1], points)
    basis = np.array([term_damping(theta, order, taps, False)[0] for order in orders.tolist()]).T
    top = np.array([term_damping(np.array([np.pi]), order, taps, False)[0][0] for order in orders.tolist()])
    ones = np.ones((points, 1))
    # Unknowns: gains, then the ripple r; −r ≤ f + 1 ≤ r and |f(ω_N)| ≤ bound.
    above = np.block([[basis, -ones], [-basis, -ones], [top, np.zeros(1)], [-top, np.zeros(1)]])
    limits = np.concatenate([-np.ones(points), np.ones(points), [nyquist, nyquist]])
    costs = np.concatenate([np.zeros(orders.size), [1.0]])
    bounds = [(None, None)] * orders.size + [(0.0, None)]
    solution = linprog(costs, A_ub=above, b_ub=limits, bounds=bounds, method="highs")
    if not solution.success or solution.x is None:
        return None
    gains = np.asarray(solution.x[:-1], dtype=np.float64)
    return measured(gains, orders, band, taps)


def measured(gains: Array, orders: Array, band: tuple[float, float], taps: int) -> Shaping:
    """Measure the f of a multi-term law."""
    fine = np.pi * np.linspace(band[0], band[1], 601)
    ripple = float(np.abs(damping_curve(fine, gains, orders, taps, False) + 1.0).max())
    return Shaping(gains, orders, ripple, float(damping_curve(np.array([np.pi]), gains, orders, taps, False)[0]))


def free_taps(taps: int, band: tuple[float, float], nyquist: float, points: int = 61) -> tuple[Array, float]:
    """Find the least ripple that any derivative part of this length can have: the same programme over the taps themselves."""
    from scipy.optimize import linprog

    # f = 2 Σ t_j cos (j+1)θ with the tail sums t_j free: leak-free by construction.
    theta = np.pi * np.linspace(band[0], band[1], points)
    j = np.arange(1, taps)
    basis, top = 2.0 * np.cos(np.outer(theta, j)), 2.0 * np.cos(np.pi * j)
    ones = np.ones((points, 1))
    above = np.block([[basis, -ones], [-basis, -ones], [top, np.zeros(1)], [-top, np.zeros(1)]])
    limits = np.concatenate([-np.ones(points), np.ones(points), [nyquist, nyquist]])
    costs = np.concatenate([np.zeros(taps - 1), [1.0]])
    bounds = [(None, None)] * (taps - 1) + [(0.0, None)]
    solution = linprog(costs, A_ub=above, b_ub=limits, bounds=bounds, method="highs")
    if not solution.success or solution.x is None:
        raise ValueError(f"nyquist = {nyquist:g}: no {taps} taps meet this bound; raise it or take more taps")
    tails = np.concatenate([[0.0], solution.x[:-1], [0.0]])
    return np.asarray(np.diff(tails) * -1.0, dtype=np.float64), float(solution.x[-1])


def best_orders(
    terms: int, band: tuple[float, float], nyquist: float, taps: int, grid: int = 14
) -> tuple[Shaping, int]:
    """Search the orders globally, the gains by linear programme: every combination on a grid, then the best polished."""
    from scipy.optimize import minimize

    solved = 0

    def ripple(orders: Array) -> float:
        nonlocal solved
        solved += 1
        if orders.min() <= 1e-3 or orders.max() >= 4.0 - 1e-3:
            return 1e3
        shape = minimax(np.asarray(orders, dtype=np.float64), band, nyquist, taps)
        return 1e3 if shape is None else shape.ripple

    axis = 4.0 * (np.arange(grid) + 0.5) / grid
    ranked = sorted((ripple(np.array(orders)), orders) for orders in combinations(axis.tolist(), terms))
    if ranked[0][0] >= 1e3:
        raise ValueError(f"nyquist = {nyquist:g}: no combination of {terms} orders meets this bound; raise it")
    found = min(
        (
            minimize(
                ripple, np.array(orders), method="Nelder-Mead", options={"maxfev": 120, "xatol": 1e-4, "fatol": 1e-7}
            )
            for _, orders in ranked[:3]
        ),
        key=lambda result: float(result.fun),
    )
    shape = minimax(np.asarray(found.x, dtype=np.float64), band, nyquist, taps)
    if shape is None:
        raise ValueError(f"nyquist = {nyquist:g}: lost the bound while polishing; raise it")
    return shape, solved
