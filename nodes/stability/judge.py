"""Whether a law may render on a known device, and how far a change may go: the figures behind a refusal, or behind a map.

Pure functions of taps, device and period. One point costs one pole radius, 0.1 to 1 ms for a law of
a few taps.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from dataclasses import dataclass

from nodes.laws import CompiledLaw
from nodes.stability.closed_loop import pole_radius
from nodes.stability.plant import Plant

# how far outside the unit circle rounding may put the pole that a loop without any spring has at z
# = 1
MARGINAL = 1e-6

_POINTS = 64
_POINTS_OF_LONG = 12
_LONG = 100  # a law of more taps takes up to a second a point, so that fewer are looked at
_BISECTIONS = 24


@dataclass(frozen=True)
class Verdict:
    """What the stability figures say of a law on a device."""

    # largest pole of the closed loop: it decays, or grows, by this factor per tick
    pole_radius: float
    plant: Plant  # what it was computed for, the delay included
    stable: bool  # whether the loop is stable; without any spring, whether its motion decays


def judge(law: CompiledLaw, plant: Plant) -> Verdict | None:
    """Judge a law on a device; None for one with code of its own, which is not linear: no pole tells whether it is stable."""
    if law.evaluate is not None:
        return None
    try:
        radius = pole_radius(law, plant)
    except ValueError:
        radius = math.inf  # taps so large that the loop's coefficients overflow
    free = law.h1 == 0.0 and not plant.anchored
    return Verdict(radius, plant, radius < 1.0 or (free and radius < 1.0 + MARGINAL))


def last_inside(
    holds: Callable[[float], bool], inside: float, outside: float, halvings: int
) -> float:
    """Narrow down by bisection where something ceases to hold; the last value found at which it does."""
    for _ in range(halvings):
        middle = 0.5 * (inside + outside)
        inside, outside = (middle, outside) if holds(middle) else (inside, middle)
    return inside


def furthest_stable(way: Callable[[float], CompiledLaw], plant: Plant) -> float | None:
    """Find the largest share (0 to 1) of a way to an unstable law at which the loop is stable; None where none looked at is."""

    def stable(share: float) -> bool:
        try:
            found = judge(way(share), plant)
        except ValueError:
            return False
        return found is not None and found.stable

    points = _POINTS
    with contextlib.suppress(ValueError):
        points = _POINTS_OF_LONG if len(way(1.0).taps) > _LONG else _POINTS
    beyond = 1.0
    for i in range(points - 1, -1, -1):
        if stable(i / points):
            inside = i / points
            break
        beyond = i / points
    else:
        return None
    return last_inside(
        stable, inside, beyond, _BISECTIONS if points == _POINTS else _BISECTIONS // 3
    )


def between(start: float, end: float, share: float) -> float:
    """Take a point between two values, exact at both ends: by equal ratios where both are of one sign, else by equal steps."""
    if share in (0.0, 1.0):
        return end if share else start
    if start * end > 0.0:
        # In logarithms, so that from 1e3 to 1e300 all decades are looked at and none overflows.
        return math.copysign(
            math.exp((1.0 - share) * math.log(abs(start)) + share * math.log(abs(end))), end
        )
    return start + (end - start) * share
