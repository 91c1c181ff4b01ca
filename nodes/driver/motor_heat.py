"""Motor heating: limits the mean square of the force, without jumps.

Heat is the mean square of the force with one time constant. Cutting the force when the heat reaches
its limit would be a jump of several newtons in a hand, so the force is lowered early enough. At any
time, the ramp down to the continuous force at the slew limit still fits below the heat limit, even
if as many ticks as the watchdog allows are lost before each step, during which the device holds its
force.

Let φ = exp(−T/τ), h the heat [N²], C the limit, s the largest change in a tick, n the watchdog's
ticks and κ = φ^(1+n). Before each tick holds κh + (1−κ)(F² + R(F)) ≤ C², where R(F) = (F³ −
C³)/(3s) for F > C bounds the sum of the squares on the ramp from F to C. Holding F for up to 1+n
ticks and then going down by s preserves that inequality, because (F−s)² + R(F−s) ≤ R(F): so there
is always a force that satisfies it.
"""

from __future__ import annotations

import math
from typing import Final

from nodes.compiled.rules import rule
from nodes.driver.state import DriverState

# bisection steps between the safe and the wanted force: 1e-7 of their difference
HALVINGS: Final = 24


def set_heat(
    s: DriverState, continuous: float | None, thermal_time: float, period: float
) -> None:
    """Set a heat limit, if any."""
    s.continuous = math.inf if continuous is None else continuous
    s.heat_keep = 1.0 if continuous is None else math.exp(-period / thermal_time)
    s.heat_reserve = s.heat_keep ** (1 + s.watchdog)


@rule
def close_tick(s: DriverState, ticks: int) -> None:
    """Account for the tick that is over, and further ones during which the force was held."""
    if s.heat_keep < 1.0 and ticks > 0:
        held = (
            s.force[0] * s.force[0] + s.force[1] * s.force[1] + s.force[2] * s.force[2]
        )
        s.heat = s.heat_keep * s.heat + (1.0 - s.heat_keep) * s.heat_largest
        # float exponent: numba turns an integer power into products with other last bits
        rest = s.heat_keep ** float(ticks - 1)
        s.heat = rest * s.heat + (1.0 - rest) * held
        s.heat_largest = 0.0
        s.heat_part = s.heat / (s.continuous * s.continuous)


@rule
def note_heat(s: DriverState) -> None:
    """Account for a force of this tick; the largest one counts."""
    squared = (
        s.wanted[0] * s.wanted[0]
        + s.wanted[1] * s.wanted[1]
        + s.wanted[2] * s.wanted[2]
    )
    s.heat_largest = max(s.heat_largest, squared)


@rule
def _fits(s: DriverState, x: float, y: float, z: float) -> bool:
    squared = x * x + y * y + z * z
    size = math.sqrt(squared)
    way = 0.0
    if size > s.continuous and math.isfinite(s.slew):
        # products, not powers, whose last bits differ when compiled
        limit = s.continuous
        way = (size * size * size - limit * limit * limit) / (3.0 * s.slew)
    reserved = s.heat_reserve * s.heat + (1.0 - s.heat_reserve) * (squared + way)
    return bool(reserved <= s.continuous * s.continuous)


@rule
def lower_heat(s: DriverState) -> bool:
    """Lower the wanted force as the heat requires. Return whether it was lowered."""
    a, b, c = s.wanted[0], s.wanted[1], s.wanted[2]
    if _fits(s, a, b, c):
        return False
    largest = max(abs(s.force[0]), abs(s.force[1]), abs(s.force[2]))
    left = s.slew
    for n in range(s.axes):
        left = min(left, max(s.slew - s.slewed[s.axis[n]], 0.0))
    share = 0.0 if left >= largest else 1.0 - left / largest
    x, y, z = s.force[0] * share, s.force[1] * share, s.force[2] * share
    low, high, found = 0.0, 1.0, 0.0
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if _fits(s, x + middle * (a - x), y + middle * (b - y), z + middle * (c - z)):
            low = found = middle
        else:
            high = middle
    s.wanted[0], s.wanted[1], s.wanted[2] = (
        x + found * (a - x),
        y + found * (b - y),
        z + found * (c - z),
    )
    return True
