"""The paper's optimisation: steepest descent on the cost (13) with steps (14) and (15).

The cost asks for f = −1 at a few low and middle frequencies and f = +1 at ω_N. With two terms and
two such frequencies there are three targets and four unknowns, hence a whole curve of optima with J
≈ 0, and the end of the descent depends on its start. The slopes along gains and orders also differ
too much for one step size. Both are shown rather than repaired. The cost can even be cheated: f =
−1 at all frequencies is a negative spring, which reduces H(1) and damps nothing, and a truncated
derivative leaks exactly that. Terms are normalised by their own f(ω_N), as in the paper.

A better method: for fixed orders f is linear in the gains, so the best gains solve a least-squares
problem or a linear programme with one solution, and only the orders are searched. There f is that
of D − D(1), whose mean is zero, so that a negative spring does not help.
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from sim.arrays import Array

CONVERGED = 1e-6  # cost below which all targets are met, each to about 1e-3


@dataclass(frozen=True)
class Targets:
    """Targets of the cost (13)."""

    theta: Array  # frequencies as ωT, 0 < ωT ≤ π, shape (k,)
    value: Array  # target of f there, normalised, shape (k,)


@dataclass(frozen=True)
class Descent:
    """One run of steepest descent."""

    # Final A_i and α_i, shape (t,).
    gains: Array
    orders: Array
    cost: Array  # J before the first step and after each step, shape (steps + 1,)
    # ``converged`` (J < 1e-6), ``slow`` (step limit), ``diverged`` (J grew a millionfold or
    # is not finite) or ``out_of_range`` (an order left 0 < α < 4).
    outcome: str


def paper_targets(fractions: tuple[float, ...] = (0.1, 0.5)) -> Targets:
    """Return the paper's targets: −1 at low and middle frequencies, +1 at ω_N."""
    return Targets(
        np.pi * np.array([*fractions, 1.0]), np.array([-1.0] * len(fractions) + [1.0])
    )


def term_damping(
    theta: Array, order: float, taps: int, leak: bool = True
) -> tuple[Array, Array]:
    """Compute f of one Grünwald–Letnikov term with f(ω_N) = 1, and its slope in the order."""
    c, dc = np.ones(taps), np.zeros(taps)
    for m in range(1, taps):
        c[m] = c[m - 1] * (m - 1.0 - order) / m
        dc[m] = dc[m - 1] * (m - 1.0 - order) / m - c[m - 1] / m
    # Re{z^−m/(1−z)} = ½ + Σ_{j=1..m} cos jθ, free of the singularity at θ = 0.
    sums = np.cumsum(np.cos(np.outer(np.arange(1, taps), theta)), axis=0)
    kernel = (0.5 if leak else 0.0) + np.concatenate([np.zeros((1, theta.size)), sums])
    # f(ω_N) is half the alternating sum, which depends on the order too.
    signs = np.where(np.arange(taps) % 2, -1.0, 1.0)
    total = float(signs @ c)
    return 2.0 / total * (c @ kernel), 2.0 / total * (
        (dc - float(signs @ dc) / total * c) @ kernel
    )


def damping_curve(
    theta: Array, gains: Array, orders: Array, taps: int, leak: bool = True
) -> Array:
    """Compute the normalised f of a multi-term law."""
    parts = np.array(
        [term_damping(theta, order, taps, leak)[0] for order in orders.tolist()]
    )
    return np.asarray(gains @ parts, dtype=np.float64)


def cost(gains: Array, orders: Array, targets: Targets, taps: int) -> float:
    """Compute J of eq. (13): the sum of squared errors."""
    miss = damping_curve(targets.theta, gains, orders, taps) - targets.value
    return float(miss @ miss)


def steepest_descent(
    gains: Array,
    orders: Array,
    targets: Targets,
    taps: int = 4,
    rate: float = 0.01,
    steps: int = 5000,
) -> Descent:
    """Descend −∇J at a fixed rate, gains (14) and orders (15) in the same step."""
    gains, orders = (
        np.array(gains, dtype=np.float64),
        np.array(orders, dtype=np.float64),
    )
    history: list[float] = []
    outcome = "slow"
    for _ in range(steps + 1):
        parts = [term_damping(targets.theta, order, taps) for order in orders.tolist()]
        values = np.array([part[0] for part in parts])
        slopes = np.array([part[1] for part in parts])
        miss = gains @ values - targets.value
        history.append(float(miss @ miss))
        if not history[-1] < 1e6 * max(history[0], 1.0):
            outcome = "diverged"
            break
        if history[-1] < CONVERGED:
            outcome = "converged"
            break
        gains, orders = (
            gains - rate * 2.0 * (values @ miss),
            orders - rate * 2.0 * gains * (slopes @ miss),
        )
        if not ((orders > 0.0) & (orders < 4.0)).all():
            outcome = "out_of_range"
            break
    return Descent(gains, orders, np.array(history), outcome)


def starting(starts: int, terms: int) -> list[Array]:
    """Return the starting orders of a survey: all combinations of a grid."""
    axis = 4.0 * (np.arange(starts) + 0.5) / starts
    return [np.array(orders) for orders in combinations(axis.tolist(), terms)]


@dataclass(frozen=True)
class Shaping:
    """Gains and orders of a multi-term law and its f, normalised (T = 2), spring as H(1)."""

    # A_i and α_i, shape (t,).
    gains: Array
    orders: Array
    ripple: float  # largest |f + 1| over the band
    nyquist: float  # f(ω_N)


def minimax(
    orders: Array,
    band: tuple[float, float],
    nyquist: float,
    taps: int,
    points: int = 61,
) -> Shaping | None:
    """Compute the gains of least ripple about f = −1 over a band, by linear programming.

    f(ω_N) is bounded.
    """
    theta = np.pi * np.linspace(band[0], band[1], points)
    basis = np.array(
        [term_damping(theta, order, taps, False)[0] for order in orders.tolist()]
    ).T
    top = np.array(
        [
            term_damping(np.array([np.pi]), order, taps, False)[0][0]
            for order in orders.tolist()
        ]
    )
    found = _least_ripple(basis, top, nyquist)
    return None if found is None else measured(found[:-1], orders, band, taps)


def _least_ripple(basis: Array, top: Array, nyquist: float) -> Array | None:
    """Solve for the coefficients of a basis and the ripple r.

    Subject to −r ≤ f + 1 ≤ r and |f(ω_N)| ≤ bound.
    """
    from scipy.optimize import linprog

    points, factors = basis.shape
    ones = np.ones((points, 1))
    above = np.block(
        [[basis, -ones], [-basis, -ones], [top, np.zeros(1)], [-top, np.zeros(1)]]
    )
    limits = np.concatenate([-np.ones(points), np.ones(points), [nyquist, nyquist]])
    bounds = [(None, None)] * factors + [(0.0, None)]
    solution = linprog(
        [0.0] * factors + [1.0], A_ub=above, b_ub=limits, bounds=bounds, method="highs"
    )
    return (
        np.asarray(solution.x, dtype=np.float64)
        if solution.success and solution.x is not None
        else None
    )


def measured(
    gains: Array, orders: Array, band: tuple[float, float], taps: int
) -> Shaping:
    """Measure f of a multi-term law."""
    fine = np.pi * np.linspace(band[0], band[1], 601)
    ripple = float(np.abs(damping_curve(fine, gains, orders, taps, False) + 1.0).max())
    return Shaping(
        gains,
        orders,
        ripple,
        float(damping_curve(np.array([np.pi]), gains, orders, taps, False)[0]),
    )


def free_taps(
    taps: int, band: tuple[float, float], nyquist: float, points: int = 61
) -> tuple[Array, float]:
    """Return the least ripple of any derivative part of this length.

    The same programme over the taps themselves.
    """
    # f = 2 Σ t_j cos (j+1)θ with free tail sums t_j: leak-free by construction.
    theta = np.pi * np.linspace(band[0], band[1], points)
    j = np.arange(1, taps)
    basis, top = 2.0 * np.cos(np.outer(theta, j)), 2.0 * np.cos(np.pi * j)
    found = _least_ripple(basis, top, nyquist)
    if found is None:
        raise ValueError(
            f"nyquist = {nyquist:g}: no {taps} taps meet this bound; raise it or take more taps"
        )
    return np.asarray(-np.diff([0.0, *found[:-1], 0.0]), dtype=np.float64), float(
        found[-1]
    )


def best_orders(
    terms: int, band: tuple[float, float], nyquist: float, taps: int, grid: int = 14
) -> tuple[Shaping, int]:
    """Search the orders globally on a grid, with linear programmes for the gains.

    The best are polished.
    """
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
    ranked = sorted(
        (ripple(np.array(orders)), orders)
        for orders in combinations(axis.tolist(), terms)
    )
    if ranked[0][0] >= 1e3:
        raise ValueError(
            f"nyquist = {nyquist:g}: no combination of {terms} orders meets this bound; raise it"
        )
    found = min(
        (
            minimize(
                ripple,
                np.array(orders),
                method="Nelder-Mead",
                options={"maxfev": 120, "xatol": 1e-4, "fatol": 1e-7},
            )
            for _, orders in ranked[:3]
        ),
        key=lambda result: float(result.fun),
    )
    shape = minimax(np.asarray(found.x, dtype=np.float64), band, nyquist, taps)
    if shape is None:
        raise ValueError(
            f"nyquist = {nyquist:g}: lost the bound while polishing; raise it"
        )
    return shape, solved
