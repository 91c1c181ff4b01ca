"""Coulomb friction, exactly: the velocity's next zero is known in closed form, so a step is split there and nowhere else.

Between two zeros of the velocity friction is one more constant force, and the map of `sim.device.model` holds; at a zero
the device sticks or turns. Kernels as those of `sim.device.model`: plain functions that are called as they stand, and compiled.
"""

from __future__ import annotations

import math

from sim.device.model import Coefficients, advance, coefficients


def halt_time(x: float, v: float, u: float, direction: float, mass: float, damping: float, stiffness: float) -> float:
    """When the velocity first returns to zero, with the force held: closed form.

    With a the acceleration now, s = b/2m and w = a + s v, the velocity is e^{−st}(v cos ωt + w sin(ωt)/ω) (hyperbolic
    when overdamped): its first zero is one arctangent away.

    Parameters
    ----------
    x : float
        Position now [m].
    v : float
        Velocity now [m/s].
    u : float
        Force held, dry friction included [N].
    direction : float
        +1 or −1: sign of the velocity now, or just after now when it is zero.
    mass : float
        m > 0 [kg].
    damping : float
        b ≥ 0 [N s/m].
    stiffness : float
        k ≥ 0 [N/m], towards x = 0.

    Returns
    -------
    float
        Time from now [s], infinite when the velocity never returns to zero.
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
    """One exact step with Coulomb friction: split wherever the velocity crosses zero, stuck where friction holds.

    Parameters
    ----------
    x : float
        Position [m].
    v : float
        Velocity [m/s]; exactly 0 while stuck.
    u : float
        Force held during the step, without friction [N].
    duration : float
        Length of the step [s].
    coefs : tuple of float, shape (6,)
        `coefficients` of the whole step.
    mass : float
        m > 0 [kg].
    damping : float
        b ≥ 0 [N s/m].
    stiffness : float
        k ≥ 0 [N/m], towards x = 0.
    friction : float
        Coulomb friction f_c ≥ 0, sliding and static alike [N].

    Returns
    -------
    tuple of float, shape (2,)
        Position [m] and velocity [m/s] at the end of the step.
    """
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
    """One exact step, with or without Coulomb friction.

    Parameters
    ----------
    x : float
        Position [m].
    v : float
        Velocity [m/s].
    u : float
        Force held during the step, without friction [N].
    duration : float
        Length of the step [s].
    coefs : tuple of float, shape (6,)
        `coefficients` of this very step.
    mass : float
        Moving mass, that of a hand included [kg].
    damping : float
        Viscous damping, that of a hand included [N s/m].
    stiffness : float
        Stiffness of the hand [N/m], 0 without one.
    friction : float or None
        Coulomb friction [N]; None for a device without.

    Returns
    -------
    tuple of float, shape (2,)
        Position [m] and velocity [m/s] at the end of the step.
    """
    if friction is None:
        return advance(x, v, u, coefs)
    return slide(x, v, u, duration, coefs, mass, damping, stiffness, friction)
