"""The driver's limits: the lower of the device's and the launch file's."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import msgspec

from nodes.driver.device import Bounds, DeviceLimits, Workspace
from nodes.driver.state import PEAKS
from nodes.parameters.checked import NonNegative, Positive

# longest ramp from the largest force down to zero [s]; a launcher waits twice as long
STOP_TIME = 1.5


class SafetyParameters(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True
):
    """Limits of the driver; None means the device's own limit.

    watchdog: Ticks without a fresh force before damping begins; armed by the first force.
    damping_ticks: Ticks of damping before the force is zero.
    damping: Damper on the device's own velocity during damping [N s/m].
    max_age: Oldest force that is accepted [ticks].
    peak_force: Largest magnitude on an axis [N].
    continuous_force: Largest root-mean-square force over `thermal_time` [N].
    thermal_time: Time constant of the motor's heating [s].
    slew: Fastest change of force [N/s].
    ramp: Time over which forces grow to their full size after a start [s]. None for `recovery`,
        unless the first force is zero: contacts due to motion have no ramp.
    recovery: The same after a jump of the position, damping, zero force, a fault or a restart of
        the driver [s]; `ramp` if that is longer. After a gap shorter than a fifth of it, the ramp
        starts from a part: each missing tick costs five ticks of ramp.
    workspace: Smallest and largest coordinate of each axis [m]; a position outside is a fault, and
        the force is zero.
    stop_after: Number of times within 2 s that the force may reach `peak_force` while the loop
        generates energy. Then the loop is unstable and the driver stops: damping, then no force
        until ``haptic node rearm`` or a restart of the driver. A force that stays at the peak while
        energy is generated stops it after 1 s. At most 64; None for never.
    hang: Duration of one tick after which the device counts as hanging, and the driver ends [s];
        None for a debugger.
    without: Which of ``peak_force``, ``slew``, ``workspace`` and ``hold`` need not be declared; a
        virtual device then has none.
    """

    watchdog: Annotated[int, msgspec.Meta(ge=1)] = 10
    damping_ticks: Annotated[int, msgspec.Meta(ge=0)] = 50
    damping: NonNegative = 0.5
    max_age: Annotated[int, msgspec.Meta(ge=0)] = 5
    peak_force: Positive | None = None
    continuous_force: Positive | None = None
    thermal_time: Positive = 1.0
    slew: Positive | None = None
    ramp: NonNegative | None = None
    recovery: NonNegative = 0.15
    workspace: Workspace | None = None
    stop_after: Annotated[int, msgspec.Meta(ge=2, le=PEAKS)] | None = 6
    hang: Positive | None = 1.0
    without: list[Literal["peak_force", "slew", "workspace", "hold"]] = []


def start_ramp(parameters: SafetyParameters) -> float:
    """Return the time over which a first, nonzero force grows to its full size [s]."""
    return parameters.recovery if parameters.ramp is None else parameters.ramp


def recovery_ramp(parameters: SafetyParameters) -> float:
    """Return the time over which a force grows again after a gap or a jump [s]."""
    return max(parameters.recovery, parameters.ramp or 0.0)


class Limits(msgspec.Struct, frozen=True, kw_only=True):
    """The effective limits: the lower of the device's and the launch file's."""

    peak: float | None  # largest magnitude on an axis [N]
    slew: float | None  # largest change per tick [N]
    continuous: float | None  # largest root-mean-square force [N]
    watchdog: int  # this and the next two as in the parameters [ticks]
    damping_ticks: int
    max_age: int
    workspace: Workspace  # smallest and largest coordinate of each axis [m]
    # overruled limits of the launch file: path, value, limit and what holds instead
    overruled: tuple[str, ...]


def undeclared(parameters: SafetyParameters, device: DeviceLimits) -> str:
    """Return which limits a real device must declare and does not, as an error text, or ""."""
    peak = parameters.peak_force is not None or math.isfinite(device.peak_force)
    bounded = parameters.workspace is not None or all(
        math.isfinite(low + high) for low, high in device.workspace
    )
    declared = {
        "peak_force": peak,
        "workspace": bounded,
        "hold": math.isfinite(device.hold),
    }
    missing = ", ".join(
        name
        for name, known in declared.items()
        if not known and name not in parameters.without
    )
    return missing and (
        f"the device declares no {missing}, which a real device must have (DeviceLimits in"
        f" nodes/driver/device.py); to start anyway: safety.without: [{missing}]"
    )


def lower(
    parameters: SafetyParameters,
    device: DeviceLimits,
    period: float,
    where: str = "safety",
) -> Limits:
    """Return the lower of a launch file's and a device's limits."""
    overruled: list[str] = []

    def least(name: str, wanted: float | None, bears: float, unit: str) -> float | None:
        if wanted is not None and wanted > bears:
            overruled.append(
                f"{where}.{name}: {wanted:g} {unit}, limit {bears:g} {unit} of the device, which"
                " holds"
            )
        value = bears if wanted is None else min(bears, wanted)
        return value if math.isfinite(value) else None

    peak = least("peak_force", parameters.peak_force, device.peak_force, "N")
    slew = least("slew", parameters.slew, device.slew, "N/s")
    if slew is not None and (peak is None or peak > slew * STOP_TIME):
        # A force must be removable within the stop time at the slew limit.
        if peak is not None:
            overruled.append(
                f"{where}.slew: {slew:g} N/s takes {peak / slew:.3g} s from {peak:g} N to zero,"
                f" limit {STOP_TIME:g} s; the largest force is {slew * STOP_TIME:g} N"
            )
        peak = slew * STOP_TIME
    silence = device.silence / period
    ticks: dict[str, int] = {}
    for name, least_ticks in (("watchdog", 1), ("damping_ticks", 0), ("max_age", 0)):
        wanted = getattr(parameters, name)
        most = max(least_ticks, int(silence)) if math.isfinite(silence) else wanted
        if wanted > most and wanted != getattr(SafetyParameters(), name):
            overruled.append(
                f"{where}.{name}: {wanted} ticks, limit {most} ticks ({device.silence:g} s) of the"
                " device, which holds"
            )
        ticks[name] = min(wanted, most)
    bounds: list[Bounds] = []
    for axis, (low, high) in enumerate(device.workspace):
        wanted_low, wanted_high = (
            (-math.inf, math.inf)
            if parameters.workspace is None
            else parameters.workspace[axis]
        )
        if parameters.workspace is not None and (
            wanted_low < low or wanted_high > high
        ):
            overruled.append(
                f"{where}.workspace[{axis}]: {wanted_low:g} to {wanted_high:g} m, limit {low:g} to"
                f" {high:g} m of the device, which holds"
            )
        bounds.append((max(low, wanted_low), min(high, wanted_high)))
    return Limits(
        peak=peak,
        slew=None if slew is None else slew * period,
        continuous=least(
            "continuous_force",
            parameters.continuous_force,
            device.continuous_force,
            "N",
        ),
        workspace=(bounds[0], bounds[1], bounds[2]),
        overruled=tuple(overruled),
        **ticks,
    )
