"""The loop of a law, a known device and one body as its world, as a matrix of one tick: exact, whatever the body's integrator.

The deflection is x = p − y. An implicit body answers the force of the same tick, so force and motion are solved together; a
stepped body moves after the force (THEORY.md §17).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from nodes.laws import CompiledLaw
from nodes.stability.plant import Plant, held_step

Rule: TypeAlias = Literal["backward_euler", "trapezoidal", "semi_implicit"]
Row: TypeAlias = NDArray[np.float64]


@dataclass(frozen=True)
class Body:
    """A mass, a spring and a damper between the coupling's point in the world and the ground, all moved together.

    Attributes
    ----------
    mass, damping, stiffness : float
        [kg], [N s/m], [N/m]; 0 where absent, not all three.
    rule : str
        ``backward_euler``: solved with the force of the same tick, and damped by the rule itself. ``trapezoidal``: solved so as
        well, but lossless: the velocity (y_k − y_k₋₁)/T obeys the trapezoidal rule. ``semi_implicit``: moved after the force,
        by `steps` steps of semi-implicit Euler a tick with implicit damping, as MuJoCo does; needs a mass.
    steps : int
        Steps a tick of ``semi_implicit``.

    Raises
    ------
    ValueError
        When a field is out of its limits.
    """

    mass: float = 0.0
    damping: float = 0.0
    stiffness: float = 0.0
    rule: Rule = "backward_euler"
    steps: int = 1

    def __post_init__(self) -> None:
        """Refuse what no passive body is."""
        values = (self.mass, self.damping, self.stiffness)
        if not all(math.isfinite(value) and value >= 0.0 for value in values) or not any(values):
            raise ValueError(f"mass, damping, stiffness = {values!r}: expected at least 0, finite, and not all 0")
        if self.steps < 1 or (self.rule == "semi_implicit" and self.mass == 0.0):
            raise ValueError(f"steps = {self.steps!r}, mass = {self.mass!r}: a stepped body needs both above 0")

    def rational(self, period: float, free: bool = False) -> tuple[list[float], list[float]]:
        """Return y/F of the coupling's point, or with `free` its way in a tick over F, by rising powers of w [m/N].

        `free` needs a body without a spring. Numerator and denominator have no common factor.
        """
        inertia, loss, k = self.mass / period**2, self.damping / period, self.stiffness
        if self.rule == "semi_implicit":
            return self._stepped(period, free)
        if self.rule == "trapezoidal":
            if free:
                return ([1.0, 1.0], [2.0 * inertia + loss, loss - 2.0 * inertia]) if self.mass else ([1.0], [loss])
            if not self.mass:
                return [1.0], [loss + 0.5 * k, 0.5 * k - loss]
            return [1.0, 1.0], [2.0 * inertia + loss + 0.5 * k, k - 4.0 * inertia, 2.0 * inertia - loss + 0.5 * k]
        if free:
            return [1.0], [inertia + loss, -inertia] if self.mass else [loss]
        below = [inertia + loss + k, -2.0 * inertia - loss, inertia]
        return [1.0], below[: 3 if self.mass else 2 if self.damping else 1]

    def _stepped(self, period: float, free: bool) -> tuple[list[float], list[float]]:
        # One step of [y, way in a tick]: the spring pulls at the old position, the damper at the new velocity.
        n, stay = self.steps, 1.0 / (1.0 + self.damping * period / (self.steps * self.mass))
        push = stay * period * period / (n * self.mass)
        one = np.array([[1.0 - self.stiffness * push / n, stay / n], [-self.stiffness * push, stay]])
        kick = np.array([push / n, push])
        whole, moved = np.eye(2), np.zeros(2)
        for _ in range(n):
            whole, moved = one @ whole, one @ moved + kick
        above = [0.0, float(moved[0]), float(whole[0, 1] * moved[1] - whole[1, 1] * moved[0])]
        if free:
            return above, [1.0, -float(whole[1, 1])]
        return above, [1.0, -float(np.trace(whole)), float(np.linalg.det(whole))]


def world_radius(law: CompiledLaw, plant: Plant, body: Body) -> float:
    """Return the largest pole of the loop of a law, a device and a body: it decays, or grows, by this factor per tick."""
    return float(np.abs(np.linalg.eigvals(world_matrix(law, plant, body))).max())


def world_matrix(law: CompiledLaw, plant: Plant, body: Body) -> NDArray[np.float64]:
    """Return one tick of the loop of a law, a device and a body.

    Of [p, v T, x₋₁ … x₋ₙ, (s₋₁, s₋₂) per section, u₋₁ … u₋ᵢ₋₁, the body's own], forces in lengths, by T²/m. Where neither hand
    nor spring ties device and body to the ground, p counts from the body: both may drift together, which is no instability.
    Raises ValueError where force and body have no common solution in a tick.
    """
    unit = plant.period**2 / plant.mass
    whole, (a11, a12, a21, a22), new, old = held_step(plant)
    drifts = body.stiffness == 0.0 and plant.stiffness == 0.0
    above, below = body.rational(plant.period, drifts)
    order = max(len(above), len(below)) - 1
    ahead = [value / below[0] / unit for value in above] + [0.0] * (order + 1 - len(above))
    back = [value / below[0] for value in below] + [0.0] * (order + 1 - len(below))

    count = len(law.sections)
    history = max(len(law.taps) - 1, 1 if count else 0)
    ends = np.cumsum([1, 1, history, 2 * count, whole + 1, order])
    (p,), (v,), past, sections, forces, own = np.split(np.eye(ends[-1]), ends[:-1])
    # F = free + gain x, with x = p − y and y = rest + give F.
    free = sum((tap * unit * before for tap, before in zip(law.taps[1:], past, strict=False)), 0.0 * p)
    gain = law.taps[0] * unit
    answers: list[Row] = []
    for s, (b0, b1, a1, a2) in enumerate(law.sections):
        answers.append(b1 * unit * past[0] - a1 * sections[2 * s] - a2 * sections[2 * s + 1])
        free, gain = free + answers[-1], gain + b0 * unit
    rest, give = own[0] if order else 0.0 * p, ahead[0]
    if not 1.0 + gain * give > 0.0:
        raise ValueError("law: force and body have no common solution in one tick: its newest tap is too negative")
    force = (free + gain * (p - rest)) / (1.0 + gain * give)
    y = rest + give * force
    x = p - y
    settled = [b0 * unit * x + answer for (b0, *_), answer in zip(law.sections, answers, strict=True)]

    acting = (-force, *(-f for f in forces))
    push, before = acting[whole] / unit, acting[whole + 1] / unit
    period = plant.period
    moved = a11 * p + a12 / period * v + new[0] * push + old[0] * before - (y if drifts else 0.0)
    faster = a21 * period * p + a22 * v + period * (new[1] * push + old[1] * before)
    shifted = [row for s, one in enumerate(settled) for row in (one, sections[2 * s])]
    following = [ahead[j] * force - back[j] * y + (own[j] if j < order else 0.0) for j in range(1, order + 1)]
    return np.array([moved, faster, *([x, *past][:history]), *shifted, *([force, *forces][: whole + 1]), *following])
