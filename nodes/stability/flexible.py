"""Exact loop with a flexible device: a second mass on a joint, and a first-order actuator.

Motor, encoder, damping and friction are on one side of the joint, the rest of the mass on the
other. The force is held between ticks, so the device is one matrix per tick (a matrix exponential,
no integration), for any delay.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nodes.laws import CompiledLaw
from nodes.stability.closed_loop import tick_matrix

Matrix = NDArray[np.float64]

_EXPECTED = {"mass": " and positive", "stiffness": ""}


@dataclass(frozen=True)
class FlexiblePlant:
    """A device of two masses and an actuator with a lag."""

    mass: float  # moving mass on both sides of the joint [kg]
    damping: float  # viscous damping to ground on the motor's side [N s/m]
    # from the sample to the force that answers it, without the lag [ticks]
    delay: float = 0.0
    # stiffness of a hand or of the device's own spring on the motor's side; below 0 for one that
    # pushes away, as a motor's poles do between two rests [N/m]
    stiffness: float = 0.0
    # time constant of the actuator, first order [s]; 0 for an immediate force
    lag: float = 0.0
    # share of the mass beyond the joint, in [0, 1); 0 for a rigid device
    share: float = 0.0
    # undamped frequency of the two masses against each other [Hz]
    frequency: float = math.inf
    loss: float = 0.0  # damping ratio of that mode

    def __post_init__(self) -> None:
        for name in ("mass", "damping", "delay", "stiffness", "lag", "share", "loss"):
            value = getattr(self, name)
            if (
                not math.isfinite(value)
                or (value < 0.0 and name != "stiffness")
                or (name == "mass" and value == 0.0)
            ):
                raise ValueError(
                    f"{name} = {value!r}: must be finite{_EXPECTED.get(name, ' and at least 0')}"
                )
        if self.share >= 1.0 or not self.frequency > 0.0:
            raise ValueError(
                f"share = {self.share!r}, frequency = {self.frequency!r}: expected share < 1,"
                " frequency > 0"
            )

    @property
    def rigid(self) -> bool:
        """Whether the device has no moving joint."""
        return self.share == 0.0 or math.isinf(self.frequency)

    @property
    def joint(self) -> tuple[float, float]:
        """Stiffness [N/m] and damping [N s/m] of the joint."""
        reduced = self.mass * self.share * (1.0 - self.share)
        pulse = 2.0 * math.pi * self.frequency
        return reduced * pulse * pulse, 2.0 * self.loss * reduced * pulse

    def continuous(self) -> tuple[Matrix, Matrix]:
        """Return A and B of the state: position and velocity on both sides, force [m, m/s, N]."""
        own = self.mass
        states = 2
        matrix = np.zeros((5, 5))
        matrix[0, 1] = 1.0
        if not self.rigid:
            own = self.mass * (1.0 - self.share)
            states = 4
            spring, damper = self.joint
            pull = np.array([-spring, -damper, spring, damper])
            matrix[1, :4] = pull / own
            matrix[2, 3] = 1.0
            matrix[3, :4] = -pull / (self.mass * self.share)
        matrix[1, :2] -= np.array([self.stiffness, self.damping]) / own
        push = np.zeros(states + 1)
        if self.lag == 0.0:
            push[1] = 1.0 / own
            return matrix[:states, :states], push[:states]
        full = np.zeros((states + 1, states + 1))
        full[:states, :states] = matrix[:states, :states]
        full[1, states] = 1.0 / own
        full[states, states] = -1.0 / self.lag
        push[states] = 1.0 / self.lag
        return full, push

    def held(self, period: float) -> tuple[int, Matrix, Matrix, Matrix]:
        """Return one tick under a held force.

        Whole ticks of delay, the device's matrix, and the effect of the force of that age and of
        the one before.
        """
        whole = math.floor(self.delay)
        fraction = self.delay - whole
        late, new = self._over((1.0 - fraction) * period)
        early, old = self._over(fraction * period)
        return whole, late @ early, new, late @ old

    def pulled(self, period: float, gravity: float) -> Matrix:
        """Return the motion within one tick due to gravity [m/s²], shape (s,)."""
        matrix, _ = self.continuous()
        pull = np.zeros(len(matrix))
        pull[1 : 2 if self.rigid else 4 : 2] = -gravity
        return self._over(period, pull)[1]

    def _over(
        self, duration: float, push: Matrix | None = None
    ) -> tuple[Matrix, Matrix]:
        from scipy.linalg import expm

        matrix, own = self.continuous()
        push = own if push is None else push
        size = len(push)
        whole = np.zeros((size + 1, size + 1))
        whole[:size, :size], whole[:size, size] = matrix * duration, push * duration
        moved = expm(whole)
        return moved[:size, :size], moved[:size, size]

    def rational(self, period: float) -> tuple[int, Matrix, Matrix]:
        """Return position over force [m/N] as whole ticks of delay, numerator and denominator.

        The function is numerator / (z^(whole + 1) · denominator), highest powers first.
        """
        whole, step, new, old = self.held(period)
        size = len(new)
        # det(zI − A + b c) − det(zI − A) is the numerator; the force is scaled so that its effect
        # is near 1.
        unit = period * period / self.mass
        denominator = np.real(np.poly(step))
        parts = np.zeros(size + 2)
        for vector, shift in ((new, 0), (old, 1)):
            closed = step.copy()
            closed[:, 0] -= vector / unit
            parts[shift : shift + size + 1] += (
                np.real(np.poly(closed)) - denominator
            ) * unit
        # the first coefficient is 1 − 1: position follows force one tick later
        return whole, parts[1:], denominator


def flexible_radius(law: CompiledLaw, period: float, plant: FlexiblePlant) -> float:
    """Return the largest pole radius of the loop of a law and a flexible device."""
    return float(np.abs(np.linalg.eigvals(loop_matrix(law, period, plant))).max())


def loop_matrix(law: CompiledLaw, period: float, plant: FlexiblePlant) -> Matrix:
    """Return one tick of that loop as a matrix (`nodes.stability.closed_loop.tick_matrix`)."""
    whole, step, new, old = plant.held(period)
    return tick_matrix(
        law, period * period / plant.mass, step, [(whole, new), (whole + 1, old)]
    )
