"""Integrators of a mass with a spring and a damper to ground, on one axis, tick by tick.

Whether a world is passive as the loop sees it depends on its integrator (THEORY.md §18). With F[k]
the force on the device, −F[k] on the world and y[k] its position, passive means Σ F[k]·(y[k−1] −
y[k]) ≥ −E₀: the energy that the world gives the coupling is bounded by what was stored in it
before. So y[k] must answer F[k] *in the same tick*.

=============  ===================================================  ================== integrator
rule                                                 lag behind lossless =============
===================================================  ================== implicit       backward
Euler; adds damping of its own              −½ tick lossless       trapezoidal rule, Z(s) at s = 2(1
− w)/(T(1 + w))    0 semi_implicit  velocity, then position; implicit damper (MuJoCo)    1 − 1/(2n)
ticks exact          exact solution under the held force                  1 tick =============
===================================================  ==================

The last two are *stepped*: F[k] is held from when it acts on the device, and moves y[k + 1] first.
They are not passive in this sense, however small the step is (n sub-steps a tick): only damping of
the world itself makes a loop with them provably stable.
"""

from __future__ import annotations

from collections import deque
from typing import Protocol

from nodes.stability.plant import Plant, held_step


class BodyMotion(Protocol):
    """A body on one axis, relative to the rest position of its spring.

    Attributes
    ----------
    compliance : float
        Motion against the force of the present tick, within that tick [m/N]; 0 if stepped.
    """

    compliance: float

    def __init__(
        self,
        body: tuple[float, float, float],
        period: float,
        steps: int,
        at: tuple[float, float],
    ) -> None: ...

    def free(self) -> float:
        """Return the position at the present tick if this tick's force were zero [m]."""
        ...

    def close(self, force: float) -> None:
        """Complete the present tick with the force on the device that answered it [N]."""
        ...

    def state(self) -> tuple[float, float]:
        """Return position [m] and velocity [m/s], to continue with other parameters."""
        ...


class Implicit:
    """Backward Euler: y = y₋₁ + T v, m (v − v₋₁)/T + c v + k y = −F."""

    def __init__(
        self,
        body: tuple[float, float, float],
        period: float,
        steps: int,
        at: tuple[float, float],
    ) -> None:
        del steps
        mass, damping, stiffness = body
        self._period = period
        self._inertia = mass / period
        self._position = mass / period**2 + damping / period
        self.compliance = 1.0 / (self._position + stiffness)
        self._y, self._v = at

    def free(self) -> float:
        """Return the position without this tick's force [m]."""
        return self.compliance * (self._position * self._y + self._inertia * self._v)

    def close(self, force: float) -> None:
        """Complete the tick."""
        y = self.free() - self.compliance * force
        self._v = (y - self._y) / self._period
        self._y = y

    def state(self) -> tuple[float, float]:
        """Return position [m] and velocity [m/s]."""
        return self._y, self._v


class Lossless:
    """Trapezoidal (bilinear) rule for m u' + c u + k ∫u = −F, with velocity u = (y − y₋₁)/T.

    With g = T/2 and ξ = ∫u: ξ = ξ₋₁ + g (u + u₋₁), and y = ξ + g u.
    """

    def __init__(
        self,
        body: tuple[float, float, float],
        period: float,
        steps: int,
        at: tuple[float, float],
    ) -> None:
        del steps
        mass, damping, stiffness = body
        self._g = 0.5 * period
        self._stiffness = stiffness
        self._massless = mass == 0.0
        inertia = mass / self._g
        self._impedance = inertia + damping + stiffness * self._g
        self._carried = inertia - damping - stiffness * self._g
        self.compliance = period / self._impedance
        y, self._u = at
        self._xi = y - self._g * self._u
        # Force on the body at the previous tick: the one that holds it, if it stands still.
        self._push = 0.0 if self._u else stiffness * self._xi

    def _speed(self, push: float) -> float:
        if self._massless:
            return (
                push - self._stiffness * (self._xi + self._g * self._u)
            ) / self._impedance
        return (
            push
            + self._push
            + self._carried * self._u
            - 2.0 * self._stiffness * self._xi
        ) / self._impedance

    def free(self) -> float:
        """Return the position without this tick's force [m]."""
        return self._xi + self._g * (self._u + 2.0 * self._speed(0.0))

    def close(self, force: float) -> None:
        """Complete the tick."""
        u = self._speed(-force)
        self._xi += self._g * (u + self._u)
        self._u = u
        self._push = -force

    def state(self) -> tuple[float, float]:
        """Return position [m] and velocity [m/s]."""
        return self._xi + self._g * self._u, self._u


class Stepped:
    """A body that moves between ticks, under the forces as they act on the device."""

    compliance = 0.0

    def __init__(
        self,
        body: tuple[float, float, float],
        period: float,
        steps: int,
        at: tuple[float, float],
    ) -> None:
        self._mass, self._damping, self._stiffness = body
        self._period, self._steps = period, steps
        self._y, self._v = at
        self._acting = 0.0  # force on the device at the present instant [N]
        # pending forces [N], each with the time from the present tick when it acts [ticks]
        self._coming: deque[tuple[float, float]] = deque()

    def hand_over(self, force: float, after: float) -> None:
        """Add a pending force [N] that takes effect `after` ticks from the present one."""
        latest = self._coming[-1][0] if self._coming else 0.0
        self._coming.append((max(after, latest), force))

    def free(self) -> float:
        """Return the position [m]; this tick's force has not moved it yet."""
        return self._y

    def close(self, force: float) -> None:
        """Move to the next tick under the pending forces."""
        del force
        now = 0.0
        while self._coming and self._coming[0][0] < 1.0:
            at, coming = self._coming.popleft()
            self._move(at - now)
            now, self._acting = at, coming
        self._move(1.0 - now)
        self._coming = deque((at - 1.0, coming) for at, coming in self._coming)

    def state(self) -> tuple[float, float]:
        """Return position [m] and velocity [m/s]."""
        return self._y, self._v

    def _move(self, part: float) -> None:
        raise NotImplementedError


class SemiImplicit(Stepped):
    """Semi-implicit Euler in sub-steps h, as MuJoCo steps a joint.

    (m + h c) v = m v₋₁ − h (F + k y₋₁), y = y₋₁ + h v.
    """

    def hand_over(self, force: float, after: float) -> None:
        """Add a pending force, rounded to the nearest sub-step."""
        super().hand_over(force, round(after * self._steps) / self._steps)

    def _move(self, part: float) -> None:
        h = self._period / self._steps
        for _ in range(round(part * self._steps)):
            pull = self._acting + self._stiffness * self._y
            self._v = (self._mass * self._v - h * pull) / (
                self._mass + h * self._damping
            )
            self._y += h * self._v


class Exact(Stepped):
    """Exact motion under a held force (nodes/stability/plant.py), for any part of a tick."""

    def _move(self, part: float) -> None:
        if part <= 0.0:
            return
        plant = Plant(
            part * self._period, self._mass, self._damping, 0.0, self._stiffness
        )
        _, (a11, a12, a21, a22), (g1, g2), _ = held_step(plant)
        y, v = self._y, self._v
        self._y = a11 * y + a12 * v - g1 * self._acting
        self._v = a21 * y + a22 * v - g2 * self._acting


INTEGRATORS: dict[str, type[BodyMotion]] = {
    "implicit": Implicit,
    "lossless": Lossless,
    "semi_implicit": SemiImplicit,
    "exact": Exact,
}


def lag_of(integrator: str, steps: int) -> float:
    """Return the lag of an integrator behind the trapezoidal rule [ticks]."""
    return {
        "implicit": -0.5,
        "lossless": 0.0,
        "semi_implicit": 1.0 - 0.5 / steps,
        "exact": 1.0,
    }[integrator]
