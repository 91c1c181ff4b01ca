"""Arguments that the stability and design studies share: the device, the loop, the law."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from messages.errors import UsageError
from nodes.cli.quantities import declare, interval
from nodes.laws import Law, law_names, load_law
from nodes.laws.parse import law_to_dict, parse_law
from nodes.parameters.registry import NotInstalledError
from nodes.parameters.yaml_io import parse_yaml
from nodes.stability.plant import Plant
from sim.cli.answers import given
from sim.device.real_devices import HANDS

if TYPE_CHECKING:
    from sim.design.hands import HandBox
    from sim.design.recorded_loop import Measured


def hand(text: str) -> tuple[float, float]:
    """Read a range of stiffness, or the name of a published hand: from none to its stiffness."""
    if text in HANDS:
        return 0.0, HANDS[text].model["stiffness"].value
    try:
        return interval(text)
    except argparse.ArgumentTypeError as error:
        raise argparse.ArgumentTypeError(
            f"{error}; hands with a name are {', '.join(HANDS)}"
        ) from error


def grasp(text: str) -> HandBox:
    """Read a box of grasps: ``stylus``, or limits of mass [kg], stiffness [N/m] and damping [N s/m], separated by commas."""
    from sim.design.hands import STYLUS, HandBox

    if text == "stylus":
        return STYLUS
    parts = text.split(",")
    if len(parts) != 3:
        raise argparse.ArgumentTypeError(
            f"{text!r}: expected stylus, or MASS,STIFFNESS,DAMPING, each a value or LOW..HIGH"
        )
    try:
        return HandBox(*(interval(part) for part in parts))
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def add_grasp(parser: argparse.ArgumentParser, what: str) -> None:
    """Declare a box of grasps."""
    text = (
        f"{what}: MASS,STIFFNESS,DAMPING of a fingertip, each a value or LOW..HIGH [kg, N/m, N"
        " s/m], or stylus"
    )
    parser.add_argument("--grasp", type=grasp, help=text)


def add_device(parser: argparse.ArgumentParser, delay: float = 0.0, hand: float = 0.0) -> None:
    """Declare the device and its loop."""
    declare(parser, mass=0.1, damping=1.0, delay=delay, rate=500.0, hand=hand)


def recorded(path: Path) -> Measured:
    """Read what a recording tells of its loop."""
    from nodes.recording.writer import RecordError
    from sim.design.recorded_loop import measure

    try:
        return measure(path)
    except (RecordError, ValueError, OSError) as error:
        raise UsageError(str(error)) from error


def device(arguments: argparse.Namespace) -> Plant:
    """Collect the device from parsed arguments."""
    return Plant(
        1.0 / arguments.rate, arguments.mass, arguments.damping, arguments.delay, arguments.hand
    )


def head(law: Law, plant: Plant, gain: str = "") -> str:
    """Say what a study is about, in its first line: the law, the device and the loop."""
    described = law_to_dict(law)
    forms = {"stiffness": "K {:g} N/m", "damping": "B {:g}", "order": "order {:g}"}
    keys = ("order",) if gain else forms
    parts = [gain] if gain else []
    parts += [forms[key].format(described[key]) for key in keys if key in described]
    device = f"m {plant.mass:g} kg, b {plant.damping:g} N s/m, hand {plant.stiffness:g} N/m"
    return (
        f"{' '.join([law.kind, ', '.join(parts)])}; {device}, delay {plant.delay:g} ticks,"
        f" {1.0 / plant.period:g} Hz"
    )


def law(
    arguments: argparse.Namespace, name: str, gain: float | None = None, nominal: bool = False
) -> Law:
    """Build the law that was asked for; what decides the answer is asked for, not assumed."""
    written = name.lstrip().startswith("{")
    data: Any = parse_yaml(name, "law") if written else {"kind": name}
    asked = given(arguments, "stiffness", "order", "taps", "gains", "derivative") | {
        "damping": gain
    }
    if isinstance(data, dict):
        data |= {key: value for key, value in asked.items() if value is not None}
    try:
        kind = data.get("kind") if isinstance(data, dict) else None
        fields = load_law(kind).__struct_fields__ if kind in law_names() else ()
        if "damping" in fields and "damping" not in data and not written:
            raise UsageError(f"{kind}: give its damping gain, --gain B; 0 is a bare spring")
        if "stiffness" in fields and nominal and "stiffness" not in data:
            raise UsageError(f"{kind}: give its nominal stiffness, --stiffness K [N/m]")
        if "stiffness" in fields:
            data.setdefault("stiffness", 1.0)
        return parse_law(data)
    except NotInstalledError as error:
        raise UsageError(str(error)) from error
