"""K_max of a law before a moving world: springs, any world, any hand, tools, devices."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from messages.errors import UsageError
from nodes.parameters.options import option, quantity
from nodes.parameters.quantities import interval, not_negative, positive
from nodes.stability.k_max import without_spring
from nodes.stability.world_limits import Moving, WorldLimits, world_limits, world_needs
from nodes.stability.worlds import OtherDevice
from sim.studies import device_options as shared
from sim.studies.device_options import DeviceOptions, LawOptions
from sim.studies.result import Findings


@dataclass(frozen=True, kw_only=True)
class WorldOptions(LawOptions, DeviceOptions):
    """Options of `world`."""

    law: str = option(default="pd", help="kind, preset or YAML mapping")
    gain: float | None = quantity("gain")
    tool_damping: float | None = option(
        type=not_negative,
        help="of a stepped tool to the ground, anything hung on it [N s/m]",
    )
    tool_mass: float | None = option(
        type=positive,
        help="of a tool moved by semi-implicit Euler, one step a tick [kg]",
    )
    device2_damping: float | None = option(
        type=positive, help="of a second device on the same law [N s/m]"
    )
    delay2: float | None = option(
        type=not_negative, help="of the second device's loop [ticks] (default: --delay)"
    )
    spring_range: tuple[float, float] | None = option(
        type=interval, metavar="LOW..HIGH", help="springs behind the surface [N/m]"
    )


@dataclass(frozen=True, repr=False, kw_only=True)
class WorldFound(Findings):
    """K_max for each kind of world, and what a stiffness needs."""

    limits: WorldLimits
    # by name with unit; of the asked stiffness
    needed: Mapping[str, float | None] | None

    @property
    def answer(self) -> dict[str, Any]:
        """Figures by name."""
        return {**self.limits.as_json(), "needed": self.needed}


def world(options: WorldOptions) -> WorldFound:
    """Compute K_max for each kind of world."""
    device, law = shared.device(options), shared.law(options, options.law, options.gain)
    if options.delay2 is not None and options.device2_damping is None:
        raise UsageError("--delay2: belongs to a second device; give --device2-damping")
    second, late = (
        options.device2_damping,
        device.delay if options.delay2 is None else options.delay2,
    )
    try:
        other = None if second is None else OtherDevice(second, late)
        moving = Moving(
            options.spring_range, options.tool_damping, options.tool_mass, other
        )
        limits = world_limits(
            without_spring(law, device.period), device, moving, worst=True
        )
        needs = (
            world_needs(law.compile(device.period), device)
            if options.stiffness is not None
            else None
        )
    except ValueError as error:
        raise UsageError(str(error)) from error
    lines = [
        shared.head(law, device, "" if options.gain is None else f"B {options.gain:g}"),
        *text(limits),
    ]
    for name, value in (needs or {}).items():
        what, unit = (
            (name.removesuffix("_kg"), "kg")
            if name.endswith("kg")
            else (name.removesuffix("_n_s_per_m"), "N s/m")
        )
        shown = "none is enough" if value is None else f"{value:.5g} {unit}"
        lines.append(f"K {options.stiffness:g} needs {what.replace('_', ' ')}: {shown}")
    return WorldFound(lines=lines, limits=limits, needed=needs)


def text(limits: WorldLimits) -> list[str]:
    """Return a line for each kind of world, and one for the worst."""
    lines = []
    for name, k in limits.k_max_n_per_m.items():
        shown = (
            "none certified"
            if k is None
            else "without limit"
            if name in limits.unlimited
            else f"{k:.6g} N/m"
        )
        lines.append(
            f"  {name.replace('_', ' '):24} {shown:>16}  {limits.worlds[name]}"
        )
    worst = limits.worst_world
    return [*lines, f"worst world: {'none to build' if worst is None else worst.text}"]
