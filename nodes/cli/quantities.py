"""The quantities that many verbs ask for, declared once: one name, one unit, one range, whatever the verb.

``--damping`` is always the device's; the law's own is ``--gain``.
"""

import argparse
import math
from collections.abc import Callable
from typing import Any, NamedTuple


class Interval(NamedTuple):
    """An option that takes LOW..HIGH, or one number that is both; without ends it has no default."""

    low: float | None = None
    high: float | None = None


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


def above_zero(text: str) -> float:
    """Read a number above 0, which may be inf."""
    value = float(text)
    if not value > 0.0:
        raise argparse.ArgumentTypeError(f"{text} must be above 0")
    return value


def interval(text: str) -> tuple[float, float]:
    """Read ``low..high``, or one number that is both."""
    low, _, high = text.partition("..")
    ends = not_negative(low), not_negative(high or low)
    if ends[0] > ends[1]:
        raise argparse.ArgumentTypeError(f"{text}: the lower end comes first")
    return ends


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number") from None
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text}: must be finite")
    return value


def _between(low: float, high: float, zero: bool = False) -> Callable[[str], float]:
    """Read a number within the limits of what is a device or a loop: beyond them figures overflow, or fill the memory."""

    def read(text: str) -> float:
        value = not_negative(text) if zero else positive(text)
        if value and not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{text}: must be between {low:g} and {high:g}{', or 0' if zero else ''}")
        return value

    return read


QUANTITIES: dict[str, tuple[Callable[[str], Any], str]] = {  # how each is read, and what it is
    "mass": (_between(1e-6, 1e6), "moving mass of the device [kg]"),
    "damping": (_between(1e-9, 1e9, zero=True), "viscous damping of the device [N s/m]"),
    "delay": (_between(1e-9, 1000.0, zero=True), "delay of the loop [ticks], fractions allowed"),
    "rate": (_between(1.0, 1e5), "rate of the loop [Hz]"),
    "hand": (_between(1e-9, 1e9, zero=True), "stiffness of a hand on the device [N/m]"),
    "stiffness": (_between(1e-9, 1e9), "nominal K of the law [N/m]"),
    "gain": (_between(1e-9, 1e9, zero=True), "damping gain B of the law [N s/m, or N s^α/m]"),
    "order": (positive, "order α of the law"),
    "taps": (int, "length of the law's tap vector, n + 1"),
}


def declare(parser: argparse.ArgumentParser, **defaults: float | Interval | None) -> None:
    """Declare some of them, each with its default here; None: there is none."""
    for name, default in defaults.items():
        read, text = QUANTITIES[name]
        if isinstance(default, Interval):
            read, text, (low, high) = interval, f"{text}, LOW..HIGH", default
            shown = None if low is None else f"{low:g}" if low == high else f"{low:g}..{high:g}"
            default = None if low is None else default
        else:
            shown = None if default is None else f"{default:g}"
        parser.add_argument(
            f"--{name}", type=read, default=default, help=text if shown is None else f"{text} (default: {shown})"
        )


def declare_law(parser: argparse.ArgumentParser) -> None:
    """Declare the parameters of a law that are most often varied."""
    declare(parser, stiffness=None, order=None, taps=None)
    parser.add_argument("--gains", choices=("physical", "paper", "unlimited"), help="unit of the gain")
    parser.add_argument("--derivative", help="realisation of the derivative, e.g. gl")
