"""Loops with moving worlds, closed independently: polynomials, matrix exponentials, ticks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mpmath
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from nodes.laws import CompiledLaw
from nodes.stability.plant import Plant, held_plant
from nodes.stability.world_loop import Body

Array = NDArray[np.float64]
Z1, ONE_MORE, Z = np.array([1.0, -1.0]), np.array([1.0, 1.0]), np.array([1.0, 0.0])


def body_in_z(body: Body, period: float) -> tuple[Array, Array]:
    """Return numerator and denominator in z of an implicit body, position over force."""
    m, c, k = body.mass / period**2, body.damping / period, body.stiffness
    if body.integrator == "lossless":
        # F = (2 m (z − 1)/(z + 1) + c + (k/2)(z + 1)/(z − 1)) q, and y = q z/(z − 1).
        below = np.polyadd(
            np.polyadd(2.0 * m * np.polymul(Z1, Z1), c * np.polymul(Z1, ONE_MORE)),
            0.5 * k * np.polymul(ONE_MORE, ONE_MORE),
        )
        return np.polymul(ONE_MORE, Z), below
    below = np.polyadd(
        np.polyadd(m * np.polymul(Z1, Z1), c * np.polymul(Z1, Z)), k * np.polymul(Z, Z)
    )
    return np.polymul(Z, Z), below


def characteristic(
    law: CompiledLaw, plant: Plant, worlds: Sequence[tuple[Array, Array]]
) -> Array:
    """Return the polynomial of 1 + H (P + Σ W), taps only; worlds as fractions in z."""
    held = held_plant(plant)
    above, below = (
        np.array(held.numerator),
        np.concatenate([held.denominator, np.zeros(held.whole + 1)]),
    )
    for top, bottom in worlds:
        above, below = (
            np.polyadd(np.polymul(above, bottom), np.polymul(top, below)),
            np.polymul(below, bottom),
        )
    shift = np.concatenate([[1.0], np.zeros(len(law.taps) - 1)])
    return np.asarray(
        np.polyadd(np.polymul(below, shift), np.polymul(above, np.array(law.taps)))
    )


def stable_in_many_digits(
    law: CompiledLaw, plant: Plant, bodies: Sequence[Body]
) -> bool:
    """Whether all poles are inside, by Schur and Cohn in 150 digits.

    For bodies of backward Euler and of the trapezoidal rule.
    """
    with mpmath.workdps(150):
        exact = np.vectorize(mpmath.mpf, otypes=[object])
        m = [
            (
                mpmath.mpf(b.mass) / mpmath.mpf(plant.period) ** 2,
                mpmath.mpf(b.damping) / mpmath.mpf(plant.period),
            )
            for b in bodies
        ]
        held = held_plant(plant)
        above, below = (
            exact(held.numerator),
            exact([*held.denominator, *[0.0] * (held.whole + 1)]),
        )
        for body, (inertia, loss) in zip(bodies, m, strict=True):
            k = mpmath.mpf(body.stiffness)
            if body.integrator == "lossless":
                top = [1, 1, 0]
                bottom = [
                    2 * inertia + loss + k / 2,
                    k - 4 * inertia,
                    2 * inertia - loss + k / 2,
                ]
                if not inertia:  # the factor z + 1 of both
                    top, bottom = [1, 0], [loss + k / 2, k / 2 - loss]
            else:
                top, bottom = (
                    [1, 0, 0],
                    [inertia + loss + k, -2 * inertia - loss, inertia],
                )
            above, below = (
                _plus(_times(above, bottom), _times(top, below)),
                _times(below, bottom),
            )
        rest = _plus(
            _times(below, [1, *[0] * (len(law.taps) - 1)]),
            _times(above, exact(law.taps)),
        )
        while len(rest) > 1:
            if not rest[-1]:
                rest = rest[:-1]
                continue
            share = rest[-1] / rest[0]
            if not abs(share) < 1:
                return False
            rest = [a - share * b for a, b in zip(rest[:-1], rest[:0:-1], strict=True)]
        return True


def _times(a: Sequence[Any], b: Sequence[Any]) -> list[Any]:
    found = [mpmath.mpf(0)] * (len(a) + len(b) - 1)
    for i, one in enumerate(a):
        for j, other in enumerate(b):
            found[i + j] += one * other
    return found


def _plus(a: Sequence[Any], b: Sequence[Any]) -> list[Any]:
    size = max(len(a), len(b))
    return [
        one + other
        for one, other in zip(
            [*[0] * (size - len(a)), *a], [*[0] * (size - len(b)), *b], strict=True
        )
    ]


def polynomial_radius(
    law: CompiledLaw, plant: Plant, worlds: Sequence[tuple[Array, Array]]
) -> float:
    """Return the largest root of 1 + H (P + Σ W), taps only; worlds as fractions in z."""
    return float(np.abs(np.roots(characteristic(law, plant, worlds))).max())


@dataclass(frozen=True)
class Chain:
    """A mass that the force moves, damped to ground, with a second mass on it; continuous."""

    mass: float
    damping: float
    delay: float
    second: float = 0.0  # [kg]; 0: none, the link then leads to the ground
    link: float = 0.0  # [N/m]
    loss: float = 0.0  # of the link [N s/m]
    ground: float = 0.0  # of the second mass [N/m]

    def continuous(self) -> tuple[Array, Array]:
        """Return A and B of positions and velocities."""
        if not self.second:
            own = np.array(
                [
                    [0.0, 1.0],
                    [-self.link / self.mass, -(self.damping + self.loss) / self.mass],
                ]
            )
            return own, np.array([0.0, 1.0 / self.mass])
        own = np.zeros((4, 4))
        own[0, 1] = own[2, 3] = 1.0
        own[1] = (
            np.array([-self.link, -self.damping - self.loss, self.link, self.loss])
            / self.mass
        )
        own[3] = (
            np.array([self.link, self.loss, -self.link - self.ground, -self.loss])
            / self.second
        )
        return own, np.array([0.0, 1.0 / self.mass, 0.0, 0.0])


def exact(own: Array, push: Array, duration: float) -> tuple[Array, Array]:
    size = len(push)
    whole = np.zeros((size + 1, size + 1))
    whole[:size, :size], whole[:size, size] = own * duration, push * duration
    moved = expm(whole)
    return moved[:size, :size], moved[:size, size]


def chains_radius(
    taps: Sequence[float], period: float, pushed_back: Chain, pushed_on: Chain
) -> float:
    """Return the pole radius of a law between two chains, without a common drift's pole at 1."""
    waits = [math.floor(chain.delay) + 1 for chain in (pushed_back, pushed_on)]
    parts, longest, history = (
        [chain.continuous() for chain in (pushed_back, pushed_on)],
        max(waits),
        len(taps) - 1,
    )
    sizes = [len(push) for _, push in parts]
    first, second = sizes
    size = first + second + history + longest
    rows = np.eye(size)
    states = [rows[:first], rows[first : first + second]]
    past, forces = (
        rows[first + second : first + second + history],
        rows[first + second + history :],
    )
    x = states[0][0] - states[1][0]
    force = taps[0] * x + sum(
        (tap * row for tap, row in zip(taps[1:], past, strict=True)), np.zeros(size)
    )
    acting = [force, *forces]
    moved = []
    for (own, push), state, chain, sign in zip(
        parts, states, (pushed_back, pushed_on), (-1.0, 1.0), strict=True
    ):
        whole = math.floor(chain.delay)
        late = chain.delay - whole
        early, old = exact(own, push, late * period)
        last, new = exact(own, push, (1.0 - late) * period)
        moved.append(
            last @ (early @ state + sign * np.outer(old, acting[whole + 1]))
            + sign * np.outer(new, acting[whole])
        )
    deflections = np.array([x, *past])[:history].reshape(history, size)
    step = np.vstack([*moved, deflections, np.array(acting)[:longest]])
    poles = np.linalg.eigvals(step)
    if not any(
        (chain.link and not chain.second) or chain.ground
        for chain in (pushed_back, pushed_on)
    ):
        poles = np.delete(poles, np.argmin(np.abs(poles - 1.0)))
    return float(np.abs(poles).max())


def played(law: CompiledLaw, plant: Plant, body: Body, ticks: int) -> Array:
    """Simulate taps, a device without a hand and an implicit body tick by tick, from 1 mm."""
    period, (own, push) = (
        plant.period,
        Chain(plant.mass, plant.damping, 0.0).continuous(),
    )
    whole = math.floor(plant.delay)
    late = plant.delay - whole
    early, old = exact(own, push, late * period)
    last, new = exact(own, push, (1.0 - late) * period)
    state, forces, x = np.array([1e-3, 0.0]), [0.0] * (whole + 2), [0.0] * len(law.taps)
    y = before = older = force_before = 0.0
    inertia, loss, k = body.mass / period**2, body.damping / period, body.stiffness
    found = np.empty(ticks)
    for tick in range(ticks):
        free = sum(tap * value for tap, value in zip(law.taps[1:], x, strict=False))
        if body.integrator == "lossless":
            # The two rules of a trapezoidal body added up, for its position; first order where a
            # part is absent.
            if body.mass:
                a0, a1, a2 = (
                    2 * inertia + loss + k / 2,
                    k - 4 * inertia,
                    2 * inertia - loss + k / 2,
                )
                rest, give = (force_before - a1 * before - a2 * older) / a0, 1.0 / a0
            else:
                rest, give = (
                    -(k / 2 - loss) * before / (k / 2 + loss),
                    1.0 / (k / 2 + loss),
                )
        else:
            a0 = inertia + loss + k
            rest, give = (
                ((2 * inertia + loss) * before - inertia * older) / a0,
                1.0 / a0,
            )
        force = (free + law.taps[0] * (state[0] - rest)) / (1.0 + law.taps[0] * give)
        y = rest + give * force
        x = [state[0] - y, *x[:-1]]
        forces = [force, *forces[:-1]]
        state = last @ (early @ state - old * forces[whole + 1]) - new * forces[whole]
        before, older, force_before = y, before, force
        found[tick] = x[0]
    return found
