"""The exact loop of a law, a known device and one body as its world, one tick as a matrix.

The deflection is x = p − y. An implicit body answers the force of the same tick, so force and
motion are solved together; a stepped body moves after the force (THEORY.md §18).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from nodes.laws import CompiledLaw
from nodes.stability.dips import Reals
from nodes.stability.plant import Plant, held_step

Integrator: TypeAlias = Literal["implicit", "lossless", "semi_implicit", "exact"]
STEPPED = (
    "semi_implicit",
    "exact",
)  # they answer a force after the tick in which it acts
HeldStep: TypeAlias = tuple[
    int, tuple[float, float, float, float], tuple[float, float], tuple[float, float]
]


@dataclass(frozen=True)
class Body:
    """A mass, a spring and a damper to ground, at the coupling's point in the world.

    Attributes
    ----------
    mass, damping, stiffness : float
        [kg], [N s/m], [N/m]; 0 if absent, not all three.
    integrator : str
        ``implicit``: backward Euler, solved with the force of the same tick; adds damping.
        ``lossless``: also solved in the same tick; the velocity (y_k − y_k₋₁)/T obeys the
        trapezoidal rule. ``semi_implicit``: moved after the force, which is held and as late as on
        the device, by `steps` steps a tick with implicit damping, as MuJoCo does. ``exact``: the
        differential equation under that held force. The last two need a mass.
    steps : int
        Steps a tick of ``semi_implicit``.

    Raises
    ------
    ValueError
        If a field is out of its limits.
    """

    mass: float = 0.0
    damping: float = 0.0
    stiffness: float = 0.0
    integrator: Integrator = "implicit"
    steps: int = 1

    def __post_init__(self) -> None:
        """Check the fields."""
        values = (self.mass, self.damping, self.stiffness)
        if not all(
            math.isfinite(value) and value >= 0.0 for value in values
        ) or not any(values):
            raise ValueError(
                f"mass, damping, stiffness = {values!r}: expected at least 0, finite, and not all 0"
            )
        if self.steps < 1 or (self.integrator in STEPPED and self.mass == 0.0):
            raise ValueError(
                f"steps = {self.steps!r}, mass = {self.mass!r}: a stepped body needs both above 0"
            )

    def rational(
        self, period: float, free: bool = False, delay: float = 0.0
    ) -> tuple[list[float], list[float]]:
        """Return y/F of the coupling's point by rising powers of w: numerator, denominator [m/N].

        With `free` it is the motion in a tick over F, for a body without a spring. `delay` of the
        force matters to stepped bodies only [ticks]. Numerator and denominator have no common
        factor.
        """
        inertia = self.mass / period**2
        loss = self.damping / period
        k = self.stiffness
        if self.integrator in STEPPED:
            return self._stepped(period, free, delay)
        if self.integrator == "lossless":
            if free:
                return (
                    ([1.0, 1.0], [2.0 * inertia + loss, loss - 2.0 * inertia])
                    if self.mass
                    else ([1.0], [loss])
                )
            if not self.mass:
                return [1.0], [loss + 0.5 * k, 0.5 * k - loss]
            return [1.0, 1.0], [
                2.0 * inertia + loss + 0.5 * k,
                k - 4.0 * inertia,
                2.0 * inertia - loss + 0.5 * k,
            ]
        if free:
            return [1.0], [inertia + loss, -inertia] if self.mass else [loss]
        below = [inertia + loss + k, -2.0 * inertia - loss, inertia]
        return [1.0], below[: 3 if self.mass else 2 if self.damping else 1]

    def _stepped(
        self, period: float, free: bool, delay: float
    ) -> tuple[list[float], list[float]]:
        if self.integrator == "exact":
            whole, (a11, a12, a21, a22), new, old = held_step(
                Plant(period, self.mass, self.damping, delay, self.stiffness)
            )
        else:
            whole, (a11, a12, a21, a22), new, old = self._euler(period, delay)
        # y = [1 0](zI − A)⁻¹ (new + w old) wⁱ F
        above = [0.0] * (whole + 1) + [
            new[0],
            a12 * new[1] - a22 * new[0] + old[0],
            a12 * old[1] - a22 * old[0],
        ]
        if free:
            return above, [1.0, -a22]
        return above, [1.0, -a11 - a22, a11 * a22 - a12 * a21]

    def _euler(self, period: float, delay: float) -> HeldStep:
        """Return one tick of semi-implicit Euler like `held_step`, the delay rounded to a step."""
        step = period / self.steps
        whole = math.floor(delay)
        late = round((delay - whole) * self.steps)
        whole, late = (whole + 1, 0) if late == self.steps else (whole, late)
        stay = 1.0 / (1.0 + self.damping * step / self.mass)
        pull = stay * step / self.mass * self.stiffness
        push = stay * step / self.mass
        one = np.array([[1.0 - step * pull, step * stay], [-pull, stay]])
        kick = np.array([step * push, push])
        moved, new, old = np.eye(2), np.zeros(2), np.zeros(2)
        for i in range(self.steps):
            moved, new, old = one @ moved, one @ new, one @ old
            if i < late:
                old = old + kick
            else:
                new = new + kick
        (a11, a12), (a21, a22) = moved.tolist()
        return (
            whole,
            (a11, a12, a21, a22),
            (float(new[0]), float(new[1])),
            (float(old[0]), float(old[1])),
        )


def world_radius(law: CompiledLaw, plant: Plant, body: Body) -> float:
    """Return the largest pole radius of the loop of a law, a device and a body."""
    return float(np.abs(np.linalg.eigvals(world_matrix(law, plant, body))).max())


def world_matrix(law: CompiledLaw, plant: Plant, body: Body) -> NDArray[np.float64]:
    """Return one tick of the loop of a law, a device and a body.

    The state is [p, v T, x₋₁ … x₋ₙ, (s₋₁, s₋₂) per section, u₋₁ … u₋ᵢ₋₁, the body's own], forces
    scaled to lengths by T²/m. If neither hand nor spring ties device and body to ground, p is
    relative to the body, because a common drift is no instability. Raises ValueError if force and
    body have no common solution in a tick.
    """
    unit = plant.period**2 / plant.mass
    whole, (a11, a12, a21, a22), new, old = held_step(plant)
    drifts = body.stiffness == 0.0 and plant.stiffness == 0.0
    above, below = body.rational(plant.period, drifts, plant.delay)
    order = max(len(above), len(below)) - 1
    ahead = [value / below[0] / unit for value in above] + [0.0] * (
        order + 1 - len(above)
    )
    back = [value / below[0] for value in below] + [0.0] * (order + 1 - len(below))

    count = len(law.sections)
    history = max(len(law.taps) - 1, 1 if count else 0)
    ends = np.cumsum([1, 1, history, 2 * count, whole + 1, order])
    (p,), (v,), past, sections, forces, own = np.split(np.eye(ends[-1]), ends[:-1])
    # F = free + gain x, with x = p − y and y = rest + give F.
    free = sum(
        (tap * unit * before for tap, before in zip(law.taps[1:], past, strict=False)),
        0.0 * p,
    )
    gain = law.taps[0] * unit
    answers: list[Reals] = []
    for s, (b0, b1, a1, a2) in enumerate(law.sections):
        answers.append(
            b1 * unit * past[0] - a1 * sections[2 * s] - a2 * sections[2 * s + 1]
        )
        free = free + answers[-1]
        gain = gain + b0 * unit
    rest = own[0] if order else 0.0 * p
    give = ahead[0]
    if not 1.0 + gain * give > 0.0:
        raise ValueError(
            "law: force and body have no common solution in one tick: its newest tap is too"
            " negative"
        )
    force = (free + gain * (p - rest)) / (1.0 + gain * give)
    y = rest + give * force
    x = p - y
    settled = [
        b0 * unit * x + answer
        for (b0, *_), answer in zip(law.sections, answers, strict=True)
    ]

    acting = (-force, *(-f for f in forces))
    push = acting[whole] / unit
    before = acting[whole + 1] / unit
    period = plant.period
    moved = (
        a11 * p
        + a12 / period * v
        + new[0] * push
        + old[0] * before
        - (y if drifts else 0.0)
    )
    faster = a21 * period * p + a22 * v + period * (new[1] * push + old[1] * before)
    shifted = [row for s, one in enumerate(settled) for row in (one, sections[2 * s])]
    following = [
        ahead[j] * force - back[j] * y + (own[j] if j < order else 0.0)
        for j in range(1, order + 1)
    ]
    return np.array(
        [
            moved,
            faster,
            *([x, *past][:history]),
            *shifted,
            *([force, *forces][: whole + 1]),
            *following,
        ]
    )
