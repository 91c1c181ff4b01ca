"""The paper's way to its optimum, reproduced: steepest descent on the cost (13) with the steps (14) and (15).

The cost asks for f = −1 at a few low and middle frequencies and f = +1 at ω_N. With two terms and two such frequencies it
has three targets and four unknowns: a whole curve of optima with J ≈ 0, so where the descent ends depends on where it
starts. And the slopes along gains and orders differ by orders of magnitude, so no one step size suits both. Both are
shown here rather than repaired; `sim.paper.shaping` is the better way. The cost can even be cheated: f = −1 at all frequencies
is a negative spring, which costs H(1) and damps nothing, and a truncated derivative leaks exactly that. Each term is
normalised by its own f(ω_N), the sum to n of eq. (9), as in the paper.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim.arrays import Array

CONVERGED = 1e-6
"""Cost below which all targets count as met: each to about 1e-3."""


@dataclass(frozen=True)
class Targets:
    """What the cost (13) asks for."""

    theta: Array  # frequencies as ωT, 0 < ωT ≤ π, shape (k,)
    value: Array  # wanted f there, normalised, shape (k,)


@dataclass(frozen=True)
class Descent:
    """One run of steepest descent."""

    # A_i and α_i at the end, shape (t,).
    gains: Array
    orders: Array
    cost: Array  # J before the first step and after each one, shape (steps + 1,)
    # ``converged`` (J < 1e-6), ``slow`` (steps used up), ``diverged`` (J grew a millionfold or is not finite) or
    # ``out_of_range`` (an order left 0 < α < 4).
    outcome: str


def paper_targets(fractions: tuple[float, ...] = (0.1, 0.5)) -> Targets:
    """Targets of the paper: −1 at low and middle frequencies, +1 at ω_N."""
    return Targets(
        np.pi * np.array([*fractions, 1.0]),
        np.array([-1.0] * len(fractions) + [1.0]),
    )


def term_damping(theta: Array, order: float, taps: int, leak: bool = True) -> tuple[Array, Array]:
    """Compute f of one Grünwald–Letnikov term with f(ω_N) = 1, and its slope along the order."""
    c, dc = np.ones(taps), np.zeros(taps)
    for m in range(1, taps):
        c[m] = c[m - 1] * (m - 1.0 - order) / m
        dc[m] = dc[m - 1] * (m - 1.0 - order) / m - c[m - 1] / m
    # Re{z^−m/(1−z)} = ½ + Σ_{j=1..m} cos jθ, free of the singularity at θ = 0.
    sums = np.cumsum(np.cos(np.outer(np.arange(1, taps), theta)), axis=0)
    kernel = (0.5 if leak else 0.0) + np.concatenate([np.zeros((1, theta.size)), sums])
    # f(ω_N) is half the alternating sum, which moves with the order too.
    signs = np.where(np.arange(taps) % 2, -1.0, 1.0)
    total = float(signs @ c)
    return 2.0 / total * (c @ kernel), 2.0 / total * ((dc - float(signs @ dc) / total * c) @ kernel)


def damping_curve(theta: Array, gains: Array, orders: Array, taps: int, leak: bool = True) -> Array:
    """Compute f of a multi-term law, normalised."""
    parts = np.array([term_damping(theta, order, taps, leak)[0] for order in orders.tolist()])
    return np.asarray(gains @ parts, dtype=np.float64)


def cost(gains: Array, orders: Array, targets: Targets, taps: int) -> float:
    """J of eq. (13): the sum of the squared misses."""
    miss = damping_curve(targets.theta, gains, orders, taps) - targets.value
    return float(miss @ miss)


def steepest_descent(
    gains: Array, orders: Array, targets: Targets, taps: int = 4, rate: float = 0.01, steps: int = 5000
) -> Descent:
    """Follow −∇J with a fixed rate, gains (14) and orders (15) in the same step."""
    gains, orders = np.array(gains, dtype=np.float64), np.array(orders, dtype=np.float64)
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


def survey(targets: Targets, taps: int, rate: float, steps: int, starts: int, terms: int = 2) -> list[Descent]:
    """Run the descent from a grid of starts: unit gains, all pairs of orders."""
    return [steepest_descent(np.ones(terms), orders, targets, taps, rate, steps) for orders in starting(starts, terms)]


def starting(starts: int, terms: int) -> list[Array]:
    """List the orders that a survey starts from: all combinations of a grid."""
    from itertools import combinations

    axis = 4.0 * (np.arange(starts) + 0.5) / starts
    return [np.array(orders) for orders in combinations(axis.tolist(), terms)]
