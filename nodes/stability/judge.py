"""Whether a law is stable on a known device, and how far a change may go.

These pure functions of taps, device and period give the figures of a refusal and of the stability
map. One point costs one pole radius, 0.1 to 1 ms for a law of a few taps.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from nodes.laws import CompiledLaw
from nodes.stability.closed_loop import pole_radius
from nodes.stability.plant import Plant

# distance outside the unit circle to which rounding may move the pole at z = 1 of a springless loop
MARGINAL = 1e-6

_POINTS = 64
_POINTS_OF_LONG = 12
_LONG = 100  # taps above which fewer points are checked: a point may take a second
_BISECTIONS = 24


@dataclass(frozen=True)
class Verdict:
    """Stability of a law on a device."""

    # largest pole radius: the loop decays, or grows, by this factor per tick
    pole_radius: float
    plant: Plant  # the device, including the delay
    stable: bool  # whether the loop is stable; without any spring, whether its motion decays
    felt: str = ""  # the shape or region whose law was judged; empty for the law itself


def judge(law: CompiledLaw, plant: Plant, springless: bool = False) -> Verdict | None:
    """Return the verdict on a law with a device; None for a law with own code (no poles).

    `springless`: the law has no stiffness at rest, but for rounding.
    """
    if law.evaluate is not None:
        return None
    try:
        radius = pole_radius(law, plant)
    except ValueError:
        radius = math.inf  # taps so large that the loop's coefficients overflow
    free = (springless or law.h1 == 0.0) and not plant.anchored
    return Verdict(radius, plant, radius < 1.0 or (free and radius < 1.0 + MARGINAL))


def last_inside(
    holds: Callable[[float], bool], inside: float, outside: float, halvings: int
) -> float:
    """Return the last value from `inside` to `outside` at which `holds` is true, by bisection."""
    for _ in range(halvings):
        middle = 0.5 * (inside + outside)
        inside, outside = (middle, outside) if holds(middle) else (inside, middle)
    return inside


def furthest_accepted(accepts: Callable[[float], bool], taps: int) -> float | None:
    """Return the largest accepted share (0 to 1) of a path to what is not accepted, or None.

    `taps`: length of the law; of a long one fewer points are checked.
    """
    long = taps > _LONG
    points = _POINTS_OF_LONG if long else _POINTS
    beyond = 1.0
    for i in range(points - 1, -1, -1):
        if accepts(i / points):
            return last_inside(
                accepts, i / points, beyond, _BISECTIONS // 3 if long else _BISECTIONS
            )
        beyond = i / points
    return None


def between(start: float, end: float, share: float) -> float:
    """Return a point between two values, exact at both ends: geometric, or linear across zero."""
    if share in (0.0, 1.0):
        return end if share else start
    if start * end > 0.0:
        # Logarithmic, so that all decades from 1e3 to 1e300 are checked and none overflows.
        low = math.log(abs(start))
        high = math.log(abs(end))
        size = math.exp((1.0 - share) * low + share * high)
        return math.copysign(size, end)
    return start + (end - start) * share
