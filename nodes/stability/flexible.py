"""A device that is more than one mass: a second mass on a joint, and an actuator with a lag. Poles of its loop, exact.

Motor, encoder, damping and friction are on one side of the joint, the rest of the mass on the
other. The force is held between ticks, so the device is one matrix per tick (a matrix exponential,
no integration), whatever the delay.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nodes.laws import CompiledLaw
from nodes.stability.closed_loop import tick_matrix

Matrix = NDArray[np.float64]


@dataclass(frozen=True)
class FlexiblePlant:
    """What the law is coupled to."""

    mass: float  # all that moves, on both sides of the joint [kg]
    damping: float  # viscous damping against the ground, on the motor's side [N s/m]
    delay: float = 0.0  # from the sample to the force that answers it, the lag not included [ticks]
    stiffness: float = 0.0  # stiffness of a hand, on the motor's side [N/m]
    # time constant of the actuator, first order [s]; 0 for a force that is there at once
    lag: float = 0.0
    # part of the mass that lies beyond the joint, in [0, 1); 0 for a rigid device
    share: float = 0.0
    frequency: float = math.inf  # of the two masses against each other, undamped [Hz]
    loss: float = 0.0  # damping ratio of that mode

    def __post_init__(self) -> None:
        for name in ("mass", "damping", "delay", "stiffness", "lag", "share", "loss"):
            value = getattr(self, name)
            if not math.isfinite(value) or value < 0.0 or (name == "mass" and value == 0.0):
                raise ValueError(
                    f"{name} = {value!r}: must be finite and"
                    f" {'positive' if name == 'mass' else 'at least 0'}"
                )
        if self.share >= 1.0 or not self.frequency > 0.0:
            raise ValueError(
                f"share = {self.share!r}, frequency = {self.frequency!r}: expected share < 1,"
                " frequency > 0"
            )

    @property
    def rigid(self) -> bool:
        """Whether no joint moves."""
        return self.share == 0.0 or math.isinf(self.frequency)

    @property
    def joint(self) -> tuple[float, float]:
        """Stiffness [N/m] and damping [N s/m] of the joint."""
        reduced = self.mass * self.share * (1.0 - self.share)
        pulse = 2.0 * math.pi * self.frequency
        return reduced * pulse * pulse, 2.0 * self.loss * reduced * pulse

    def continuous(self) -> tuple[Matrix, Matrix]:
        """Give A and B of position and velocity on both sides of the joint and the actuator's force [m, m/s, N]."""
        own, states = self.mass, 2
        matrix = np.zeros((5, 5))
        matrix[0, 1] = 1.0
        if not self.rigid:
            own, states = self.mass * (1.0 - self.share), 4
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
        """One tick, force held: whole ticks of delay, own matrix, what the force so many ticks ago adds and the one before."""
        whole = math.floor(self.delay)
        fraction = self.delay - whole
        late, new = self._over((1.0 - fraction) * period)
        early, old = self._over(fraction * period)
        return whole, late @ early, new, late @ old

    def pulled(self, period: float, gravity: float) -> Matrix:
        """Motion that gravity, against the coordinate [m/s²], adds within one tick, shape (s,)."""
        matrix, _ = self.continuous()
        pull = np.zeros(len(matrix))
        pull[1 : 2 if self.rigid else 4 : 2] = -gravity
        return self._over(period, pull)[1]

    def _over(self, duration: float, push: Matrix | None = None) -> tuple[Matrix, Matrix]:
        from scipy.linalg import expm

        matrix, own = self.continuous()
        push = own if push is None else push
        size = len(push)
        whole = np.zeros((size + 1, size + 1))
        whole[:size, :size], whole[:size, size] = matrix * duration, push * duration
        moved = expm(whole)
        return moved[:size, :size], moved[:size, size]

    def rational(self, period: float) -> tuple[int, Matrix, Matrix]:
        """Position over force: whole ticks of delay, numerator [m/N] over z^(whole + 1) denominator, highest power first."""
        whole, step, new, old = self.held(period)
        size = len(new)
        # det(zI − A + b c) − det(zI − A) is the numerator; in units in which the force's effect is
        # about 1.
        unit = period * period / self.mass
        denominator = np.real(np.poly(step))
        parts = np.zeros(size + 2)
        for vector, shift in ((new, 0), (old, 1)):
            closed = step.copy()
            closed[:, 0] -= vector / unit
            parts[shift : shift + size + 1] += (np.real(np.poly(closed)) - denominator) * unit
        # the first is 1 − 1: position follows force one tick later
        return whole, parts[1:], denominator


def flexible_radius(law: CompiledLaw, period: float, plant: FlexiblePlant) -> float:
    """Largest pole of the loop of a law and a flexible device, as `nodes.stability.closed_loop.pole_radius` of a rigid one."""
    return float(np.abs(np.linalg.eigvals(loop_matrix(law, period, plant))).max())


def loop_matrix(law: CompiledLaw, period: float, plant: FlexiblePlant) -> Matrix:
    """One tick of the loop of a law and a flexible device (`nodes.stability.closed_loop.tick_matrix`)."""
    whole, step, new, old = plant.held(period)
    return tick_matrix(law, period * period / plant.mass, step, [(whole, new), (whole + 1, old)])
