"""Exact Coulomb friction: a step is split only where the velocity crosses zero.

The next zero of the velocity is known in closed form. Between two zeros friction is a constant
force, so the map of `sim.device.model` holds; at a zero the device sticks or reverses. Kernels as
those of `sim.device.model`: plain functions that are interpreted and compiled.
"""

import math

from nodes.compiled.rules import rule
from sim.device.model import Coefficients, advance, coefficients


@rule
def halt_time(
    x: float,
    v: float,
    u: float,
    direction: float,
    mass: float,
    damping: float,
    stiffness: float,
) -> float:
    """Return the time until the velocity reaches zero under a held force [s]; inf if never.

    With the present acceleration a, s = b/2m and w = a + s v, the velocity is e^{−st}(v cos ωt + w
    sin(ωt)/ω) (hyperbolic if overdamped), so its first zero is an arctangent.
    """
    s = damping / (2.0 * mass)
    speed = v * direction
    w = ((u - stiffness * x - damping * v) / mass + s * v) * direction
    squared = s * s - stiffness / mass
    if squared < 0.0:
        root = math.sqrt(-squared)
        # From rest the next zero is half a period away, regardless of the rounding of w.
        return (math.atan2(root * speed, -w) if speed > 0.0 else math.pi) / root
    root = math.sqrt(squared)
    if speed <= 0.0 or -w <= root * speed:
        return math.inf
    if root == 0.0:
        return speed / -w
    return 0.5 * math.log1p(2.0 * root * speed / (-w - root * speed)) / root


@rule
def slide(
    x: float,
    v: float,
    u: float,
    duration: float,
    coefs: Coefficients,
    mass: float,
    damping: float,
    stiffness: float,
    friction: float,
) -> tuple[float, float]:
    """Advance by one exact step with Coulomb friction, split at zeros of the velocity."""
    remaining = duration
    whole = True
    while True:
        if v == 0.0:
            net = u - stiffness * x
            if abs(net) <= friction:
                return x, 0.0
            direction = 1.0 if net > 0.0 else -1.0
        else:
            direction = 1.0 if v > 0.0 else -1.0
        sliding = u - direction * friction
        halt = halt_time(x, v, sliding, direction, mass, damping, stiffness)
        if not halt < remaining:
            if whole:
                return advance(x, v, sliding, coefs)
            return advance(
                x, v, sliding, coefficients(mass, damping, stiffness, remaining)
            )
        x, v = advance(x, v, sliding, coefficients(mass, damping, stiffness, halt))
        v = 0.0
        remaining -= halt
        whole = False


@rule
def move(
    x: float,
    v: float,
    u: float,
    duration: float,
    coefs: Coefficients,
    mass: float,
    damping: float,
    stiffness: float,
    friction: float | None,
) -> tuple[float, float]:
    """Advance by one exact step, with Coulomb friction unless it is None or 0."""
    if friction is None or friction == 0.0:
        return advance(x, v, u, coefs)
    return slide(x, v, u, duration, coefs, mass, damping, stiffness, friction)
