"""How stiff a law may be when the world behind it moves: a wall, springs, any world, any hand, a tool, two devices."""

import argparse

from messages.errors import UsageError
from nodes.cli.quantities import declare, declare_law, interval, not_negative, positive
from nodes.stability.k_max import without_spring
from nodes.stability.world_limits import Moving, WorldLimits, world_limits, world_needs
from nodes.stability.worlds import OtherDevice
from sim.cli import arguments as shared
from sim.cli.answers import add_answer, report


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        "--law", default="pd", help="kind, preset or YAML mapping (default: %(default)s)"
    )
    declare(parser, gain=None)
    declare_law(parser)
    parser.add_argument(
        "--tool-damping",
        type=not_negative,
        help="of a stepped tool to the ground, anything hung on it [N s/m]",
    )
    parser.add_argument(
        "--tool-mass",
        type=positive,
        help="of a tool moved by semi-implicit Euler, one step a tick [kg]",
    )
    parser.add_argument(
        "--device2-damping", type=positive, help="of a second device on the same law [N s/m]"
    )
    parser.add_argument(
        "--delay2", type=not_negative, help="of the second device's loop [ticks] (default: --delay)"
    )
    parser.add_argument(
        "--spring-range",
        type=interval,
        metavar="LOW..HIGH",
        help="springs behind the surface [N/m]",
    )
    shared.add_device(parser)
    add_answer(parser, run, files=False)


def run(arguments: argparse.Namespace) -> int:
    """Find K_max for each kind of world."""
    device, law = shared.device(arguments), shared.law(arguments, arguments.law, arguments.gain)
    if arguments.delay2 is not None and arguments.device2_damping is None:
        raise UsageError("--delay2: belongs to a second device; give --device2-damping")
    second, late = (
        arguments.device2_damping,
        device.delay if arguments.delay2 is None else arguments.delay2,
    )
    try:
        other = None if second is None else OtherDevice(second, late)
        moving = Moving(arguments.spring_range, arguments.tool_damping, arguments.tool_mass, other)
        limits = world_limits(without_spring(law, device.period), device, moving, worst=True)
        needs = (
            world_needs(law.compile(device.period), device)
            if arguments.stiffness is not None
            else None
        )
    except ValueError as error:
        raise UsageError(str(error)) from error
    lines = [
        shared.head(law, device, "" if arguments.gain is None else f"B {arguments.gain:g}"),
        *text(limits),
    ]
    for name, value in (needs or {}).items():
        what, unit = (
            (name.removesuffix("_kg"), "kg")
            if name.endswith("kg")
            else (name.removesuffix("_n_s_per_m"), "N s/m")
        )
        shown = "none is enough" if value is None else f"{value:.5g} {unit}"
        lines.append(f"K {arguments.stiffness:g} needs {what.replace('_', ' ')}: {shown}")
    return report(arguments, {**limits.as_json(), "needed": needs}, lines)


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
        kinds = limits.about[name].partition(";")[0]
        lines.append(f"  {name.replace('_', ' '):24} {shown:>16}  {kinds}")
    worst = limits.worst_world
    return [*lines, f"worst world: {'none to build' if worst is None else worst.text}"]
