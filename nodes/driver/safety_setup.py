"""The limits of a run put into a driver's state."""

from __future__ import annotations

import math

from nodes.driver.limits import Limits, SafetyParameters, recovery_ramp, start_ramp
from nodes.driver.motor_heat import set_heat
from nodes.driver.safety import REACH
from nodes.driver.state import IDLE, DriverState
from nodes.driver.swings import PRESSES, STOP_WINDOW


def set_safety(
    s: DriverState, parameters: SafetyParameters, limits: Limits, period: float
) -> None:
    """Set the limits of a run."""
    s.peak = math.inf if limits.peak is None else limits.peak
    s.slew = math.inf if limits.slew is None else limits.slew
    s.unlimited = (
        limits.peak is None and limits.slew is None and limits.continuous is None
    )
    s.max_age, s.watchdog, s.damping_ticks = (
        limits.max_age,
        limits.watchdog,
        limits.damping_ticks,
    )
    s.damping = parameters.damping
    s.start_ticks = round(start_ramp(parameters) / period)
    s.recovery_ticks = round(recovery_ramp(parameters) / period)
    s.ramp_ticks = s.start_ticks
    s.ramp_seq = -1
    # before the first force nothing is felt, and that force has no cause in motion
    s.begins = 1
    s.felt_seq = -1
    s.always_ramp = parameters.ramp is not None
    set_workspace(s, limits)
    s.reach = REACH
    set_heat(s, limits.continuous, parameters.thermal_time, period)
    # oscillation is defined by a peak force
    s.stop_after = 0 if limits.peak is None else parameters.stop_after or 0
    s.pressed_since, s.pressed_ticks = -1, pressed_ticks(s.stop_after, period)
    s.safety = IDLE
    s.force_seq = -1
    s.since = 0
    s.limited_at = -1


def pressed_ticks(stop_after: int, period: float) -> int:
    """Return the ticks at its limit after which a force counts again as reaching it."""
    return max(round(STOP_WINDOW / (PRESSES * max(stop_after, 1) * period)), 1)


def set_workspace(s: DriverState, limits: Limits) -> None:
    """Set where there may be a force."""
    s.workspace[:] = [bound for bounds in limits.workspace for bound in bounds]
    s.bounded = any(map(math.isfinite, s.workspace))
