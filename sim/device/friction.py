"""Coulomb friction, exactly: the velocity's next zero is known in closed form, so a step is split there and nowhere else.

Between two zeros of the velocity friction is one more constant force, and the map of
`sim.device.model` holds; at a zero the device sticks or turns. Kernels as those of
`sim.device.model`: plain functions that are called as they stand, and compiled.
"""

import math

from nodes.compiled.rules import rule
from sim.device.model import Coefficients, advance, coefficients


@rule
def halt_time(
    x: float, v: float, u: float, direction: float, mass: float, damping: float, stiffness: float
) -> float:
    """When the velocity first returns to zero, with the force held: closed form.

    With a the acceleration now, s = b/2m and w = a + s v, the velocity is e^{−st}(v cos ωt + w
    sin(ωt)/ω) (hyperbolic when overdamped): its first zero is one arctangent away.
    """
    s = damping / (2.0 * mass)
    speed = v * direction
    w = ((u - stiffness * x - damping * v) / mass + s * v) * direction
    squared = s * s - stiffness / mass
    if squared < 0.0:
        root = math.sqrt(-squared)
        # From rest the next zero is half a period away, whatever the rounding of w says.
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
    """One exact step with Coulomb friction: split wherever the velocity crosses zero, stuck where friction holds."""
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
            return advance(x, v, sliding, coefficients(mass, damping, stiffness, remaining))
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
    """One exact step, with or without Coulomb friction; None or 0 is none."""
    if friction is None or friction == 0.0:
        return advance(x, v, u, coefs)
    return slide(x, v, u, duration, coefs, mass, damping, stiffness, friction)
