"""Arguments that the stability and design studies share: the device, the loop, the law, and where results go."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nodes.cli.main import UsageError, add_json
from nodes.laws import Law, law_names, load_law
from nodes.laws.parse import law_to_dict, parse_law
from nodes.parameters.store import ParameterError
from nodes.parameters.yaml_io import parse_yaml
from nodes.stability.plant import Plant
from sim.device.presets import HANDS

if TYPE_CHECKING:
    from sim.design.recorded_loop import Measured


def positive(text: str) -> float:
    """Read a positive, finite number."""
    value = _number(text)
    if not value > 0.0:
        raise argparse.ArgumentTypeError(f"{text}: must be positive")
    return value


def not_negative(text: str) -> float:
    """Read a finite number that is at least 0."""
    value = _number(text)
    if not value >= 0.0:
        raise argparse.ArgumentTypeError(f"{text}: must be at least 0")
    return value


def interval(text: str) -> tuple[float, float]:
    """Read ``low..high``, or one number that is both."""
    low, _, high = text.partition("..")
    ends = not_negative(low), not_negative(high or low)
    if ends[0] > ends[1]:
        raise argparse.ArgumentTypeError(f"{text}: the lower end comes first")
    return ends


def hand(text: str) -> tuple[float, float]:
    """Read a range of stiffness, or the name of a published hand: from none to its stiffness."""
    return (0.0, HANDS[text].model["stiffness"].value) if text in HANDS else interval(text)


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number") from None
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text}: must be finite")
    return value


def add_loop(parser: argparse.ArgumentParser, delay: float = 0.0) -> None:
    """Declare the damping of the device, and the loop."""
    parser.add_argument(
        "--damping", type=not_negative, default=1.0, help="viscous damping of the device [N s/m] (default: %(default)s)"
    )
    parser.add_argument(
        "--delay",
        type=not_negative,
        default=delay,
        help="delay of the loop [ticks], fractions allowed (default: %(default)s)",
    )
    parser.add_argument("--rate", type=positive, default=500.0, help="rate of the loop [Hz] (default: %(default)s)")


def add_device(parser: argparse.ArgumentParser, delay: float = 0.0, hand: float = 0.0) -> None:
    """Declare the device and its loop."""
    parser.add_argument("--mass", type=positive, default=0.1, help="moving mass [kg] (default: %(default)s)")
    add_loop(parser, delay)
    parser.add_argument(
        "--hand",
        type=not_negative,
        default=hand,
        help="stiffness of a hand on the device [N/m] (default: %(default)s)",
    )


def recorded(path: Path) -> Measured:
    """Read what a recording tells of its loop."""
    from nodes.recording.writer import RecordError
    from sim.design.recorded_loop import measure

    try:
        return measure(path)
    except (RecordError, ValueError, OSError) as error:
        raise UsageError(str(error)) from error


def add_law(parser: argparse.ArgumentParser) -> None:
    """Declare a law and the parameters that are most often varied."""
    parser.add_argument("--stiffness", type=positive, help="nominal K [N/m]")
    parser.add_argument("--order", type=positive, help="α of pd_alpha")
    parser.add_argument("--taps", type=int, help="length of the derivative's tap vector, n + 1")
    parser.add_argument("--gains", choices=("physical", "paper", "unlimited"), help="unit of the gain")
    parser.add_argument("--derivative", help="realisation of the derivative, e.g. gl")


def add_answer(parser: argparse.ArgumentParser) -> None:
    """Declare --json and --out."""
    add_json(parser)
    parser.add_argument(
        "--out-dir",
        "--out",
        type=Path,
        default=Path("studies"),
        dest="out",
        help="directory of files (default: %(default)s)",
    )


def device(arguments: argparse.Namespace) -> Plant:
    """Collect the device from parsed arguments."""
    return Plant(1.0 / arguments.rate, arguments.mass, arguments.damping, arguments.delay, arguments.hand)


def head(law: Law, plant: Plant, gain: str = "") -> str:
    """Say what a study is about, in its first line: the law, the device and the loop."""
    told = law_to_dict(law)
    forms = {"stiffness": "K {:g} N/m", "damping": "B {:g}", "order": "order {:g}"}
    keys = ("order",) if gain else forms
    parts = [gain] if gain else []
    parts += [forms[key].format(told[key]) for key in keys if key in told]
    device = f"m {plant.mass:g} kg, b {plant.damping:g} N s/m, hand {plant.stiffness:g} N/m"
    return f"{' '.join([law.kind, ', '.join(parts)])}; {device}, delay {plant.delay:g} ticks, {1.0 / plant.period:g} Hz"


def law(arguments: argparse.Namespace, name: str, gain: float | None = None, nominal: bool = False) -> Law:
    """Build the law that was asked for; what decides the answer is asked for, not assumed."""
    data: Any = {"kind": name}
    if name.lstrip().startswith("{"):
        try:
            data = parse_yaml(name, "law")
        except ParameterError as error:
            raise UsageError(str(error)) from error
    given = {
        "stiffness": arguments.stiffness,
        "damping": gain,
        "order": arguments.order,
        "taps": arguments.taps,
        "gains": arguments.gains,
        "derivative": arguments.derivative,
    }
    if isinstance(data, dict):
        data |= {key: value for key, value in given.items() if value is not None}
    try:
        kind = data.get("kind") if isinstance(data, dict) else None
        fields = load_law(kind).__struct_fields__ if kind in law_names() else ()
        if "damping" in fields and "damping" not in data and not name.lstrip().startswith("{"):
            raise UsageError(f"{kind}: give its damping gain, --gain B; 0 is a bare spring")
        if "stiffness" in fields and nominal and "stiffness" not in data:
            raise UsageError(f"{kind}: give its nominal stiffness, --stiffness K [N/m]")
        if "stiffness" in fields:
            data.setdefault("stiffness", 1.0)
        return parse_law(data)
    except (ParameterError, TypeError) as error:
        raise UsageError(str(error)) from error
