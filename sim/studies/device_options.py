"""Arguments shared by the stability and design studies: the device, the loop, the law."""

from __future__ import annotations

from argparse import ArgumentTypeError
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from messages.errors import UsageError
from nodes.laws import Law, law_names, load_law
from nodes.laws.parse import law_to_dict, parse_law
from nodes.parameters.options import Options, option, quantity
from nodes.parameters.quantities import interval
from nodes.parameters.registry import NotInstalledError
from nodes.parameters.yaml_io import parse_yaml
from nodes.stability.plant import Plant
from sim.device.real_devices import HANDS

if TYPE_CHECKING:
    from sim.design.hand_box import HandBox
    from sim.design.recorded_loop import Measured


def hand(text: str) -> tuple[float, float]:
    """Read a range of stiffness [N/m]; the name of a published hand means 0 to its stiffness."""
    if text in HANDS:
        return 0.0, HANDS[text].model["stiffness"].value
    try:
        return interval(text)
    except ArgumentTypeError as error:
        raise ArgumentTypeError(
            f"{error}; hands with a name are {', '.join(HANDS)}"
        ) from error


def grasp(text: str) -> HandBox:
    """Read a box of grasps: ``stylus``, or MASS,STIFFNESS,DAMPING.

    Each is a value or a range: mass [kg], stiffness [N/m] and damping [N s/m].
    """
    from sim.design.hand_box import HandBox
    from sim.design.hands import STYLUS

    if text == "stylus":
        return STYLUS
    parts = text.split(",")
    if len(parts) != 3:
        raise ArgumentTypeError(
            f"{text!r}: expected stylus, or MASS,STIFFNESS,DAMPING, each a value or LOW..HIGH"
        )
    try:
        return HandBox(*(interval(part) for part in parts))
    except ValueError as error:
        raise ArgumentTypeError(str(error)) from error


def grasp_option(what: str) -> Any:
    """Declare a box of grasps; `what` is its purpose."""
    text = (
        f"{what}: MASS,STIFFNESS,DAMPING of a fingertip, each a value or LOW..HIGH [kg, N/m, N"
        " s/m], or stylus"
    )
    return option(type=grasp, help=text)


@dataclass(frozen=True, kw_only=True)
class DeviceOptions(Options):
    """A device and its loop."""

    mass: float = quantity("mass", 0.1)
    damping: float = quantity("damping", 1.0)
    delay: float = quantity("delay", 0.0)
    rate: float = quantity("rate", 500.0)
    hand: float = quantity("hand", 0.0)


@dataclass(frozen=True, kw_only=True)
class LawOptions(Options):
    """The most often varied parameters of a law."""

    stiffness: float | None = quantity("stiffness")
    order: float | None = quantity("order")
    taps: int | None = quantity("taps")
    gains: str | None = option(
        choices=("physical", "paper", "unlimited"), help="unit of the gain"
    )
    derivative: str | None = option(help="realisation of the derivative, e.g. gl")


def recorded(path: Path) -> Measured:
    """Measure the loop of a recording."""
    from nodes.recording.writer import RecordError
    from sim.design.recorded_loop import measure

    try:
        return measure(path)
    except (RecordError, ValueError, OSError) as error:
        raise UsageError(str(error)) from error


def refuse_taps(taps: int) -> None:
    """Refuse a length of a designed law that is not searched."""
    if not 1 <= taps <= 12:
        raise UsageError(
            f"--taps {taps}: between 1 and 12; the search is over each of them"
        )


def device(options: DeviceOptions) -> Plant:
    """Return the device of parsed options."""
    return Plant(
        1.0 / options.rate, options.mass, options.damping, options.delay, options.hand
    )


def head(law: Law, plant: Plant, gain: str = "") -> str:
    """Return the first line of a study: the law, the device and the loop."""
    described = law_to_dict(law)
    forms = {"stiffness": "K {:g} N/m", "damping": "B {:g}", "order": "order {:g}"}
    keys = ("order",) if gain else forms
    parts = [gain] if gain else []
    parts += [forms[key].format(described[key]) for key in keys if key in described]
    device = (
        f"m {plant.mass:g} kg, b {plant.damping:g} N s/m, hand {plant.stiffness:g} N/m"
    )
    return (
        f"{' '.join([law.kind, ', '.join(parts)])}; {device}, delay {plant.delay:g} ticks,"
        f" {1.0 / plant.period:g} Hz"
    )


def law(
    options: LawOptions, name: str, gain: float | None = None, nominal: bool = False
) -> Law:
    """Build the law of the options; raises UsageError if a decisive parameter is missing."""
    written = name.lstrip().startswith("{")
    data: Any = parse_yaml(name, "law") if written else {"kind": name}
    asked = options.chosen("stiffness", "order", "taps", "gains", "derivative") | {
        "damping": gain
    }
    if isinstance(data, dict):
        data |= {key: value for key, value in asked.items() if value is not None}
    try:
        kind = data.get("kind") if isinstance(data, dict) else None
        fields = load_law(kind).__struct_fields__ if kind in law_names() else ()
        if "damping" in fields and "damping" not in data and not written:
            raise UsageError(
                f"{kind}: give its damping gain, --gain B; 0 is a bare spring"
            )
        if "stiffness" in fields and nominal and "stiffness" not in data:
            raise UsageError(f"{kind}: give its nominal stiffness, --stiffness K [N/m]")
        if "stiffness" in fields:
            data.setdefault("stiffness", 1.0)
        return parse_law(data)
    except NotInstalledError as error:
        raise UsageError(str(error)) from error
