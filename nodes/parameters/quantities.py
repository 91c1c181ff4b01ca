"""Quantities that many verbs accept, declared once: one name, one unit, one range.

``--damping`` is always the device's; the law's own is ``--gain``.
"""

import math
from argparse import ArgumentParser, ArgumentTypeError
from collections.abc import Callable
from typing import Any, NamedTuple


class Interval(NamedTuple):
    """Default of an option that accepts LOW..HIGH or one number; without ends, no default."""

    low: float | None = None
    high: float | None = None


# Smallest nonzero quantity; its inverse is the largest, so that squares and quotients stay finite.
_SMALLEST = 1e-12


def positive(text: str) -> float:
    """Parse a positive, finite number."""
    value = number(text)
    if not value > 0.0:
        raise ArgumentTypeError(f"{text}: must be positive")
    return value


def not_negative(text: str) -> float:
    """Parse a finite number of at least 0."""
    value = number(text)
    if not value >= 0.0:
        raise ArgumentTypeError(f"{text}: must be at least 0")
    return value


def above_zero(text: str) -> float:
    """Parse a number above 0; inf is allowed."""
    return math.inf if text.strip().lower() in ("inf", "infinity") else positive(text)


def interval(text: str) -> tuple[float, float]:
    """Parse ``low..high``, or one number for both ends."""
    low, _, high = text.partition("..")
    ends = not_negative(low), not_negative(high or low)
    if ends[0] > ends[1]:
        raise ArgumentTypeError(f"{text}: the lower end must come first")
    return ends


def number(text: str) -> float:
    """Parse a finite number, of either sign or 0."""
    try:
        value = float(text)
    except ValueError:
        raise ArgumentTypeError(f"{text!r} is not a number") from None
    if not math.isfinite(value):
        raise ArgumentTypeError(f"{text}: must be finite")
    if value and not _SMALLEST <= abs(value) <= 1.0 / _SMALLEST:
        raise ArgumentTypeError(
            f"{text}: must be between {_SMALLEST:g} and {1.0 / _SMALLEST:g}"
        )
    return value


def between(low: float, high: float, zero: bool = False) -> Callable[[str], float]:
    """Return a parser of numbers within physical limits, so that results stay finite."""

    def read(text: str) -> float:
        """Parse a number."""
        value = not_negative(text) if zero else positive(text)
        if value and not low <= value <= high:
            raise ArgumentTypeError(
                f"{text}: must be between {low:g} and {high:g}{', or 0' if zero else ''}"
            )
        return value

    return read


def whole(low: int, high: int) -> Callable[[str], int]:
    """Return a parser of integers from `low` to `high`."""

    def read(text: str) -> int:
        """Parse an integer."""
        try:
            value = int(text)
        except ValueError:
            raise ArgumentTypeError(f"{text[:40]!r} is not a whole number") from None
        if not low <= value <= high:
            raise ArgumentTypeError(f"{value:d}: must be between {low} and {high}")
        return value

    return read


COUNT = whole(1, 100_000)
ROUNDS = whole(1, 10_000)  # rounds of a benchmark
PORT = whole(0, 65_535)  # 0: any free port
SEED = whole(0, 2**32 - 1)
SECONDS = between(1e-3, 86_400.0)  # duration of a run


QUANTITIES: dict[str, tuple[Callable[[str], Any], str]] = {  # parser and help of each
    "mass": (between(1e-6, 1e6), "moving mass of the device [kg]"),
    "damping": (between(1e-9, 1e9, zero=True), "viscous damping of the device [N s/m]"),
    "delay": (
        between(1e-9, 1000.0, zero=True),
        "delay of the loop [ticks], fractions allowed",
    ),
    "rate": (between(1.0, 1e5), "rate of the loop [Hz]"),
    "hand": (between(1e-9, 1e9, zero=True), "stiffness of a hand on the device [N/m]"),
    "stiffness": (between(1e-9, 1e9), "nominal K of the law [N/m]"),
    "gain": (
        between(1e-9, 1e9, zero=True),
        "damping gain B of the law [N s/m, or N s^α/m]",
    ),
    "order": (positive, "order α of the law"),
    "taps": (whole(1, 100_000), "length of the law's tap vector, n + 1"),
}


def declare(parser: ArgumentParser, **defaults: float | Interval | None) -> None:
    """Declare options for some quantities, each with its default; None for no default."""
    for name, default in defaults.items():
        read, text = QUANTITIES[name]
        if isinstance(default, Interval):
            read = interval
            text = f"{text}, LOW..HIGH"
            (low, high) = default
            shown = (
                None
                if low is None
                else f"{low:g}"
                if low == high
                else f"{low:g}..{high:g}"
            )
            default = None if low is None else default
        else:
            shown = None if default is None else f"{default:g}"
        parser.add_argument(
            f"--{name}",
            type=read,
            default=default,
            help=text if shown is None else f"{text} (default: {shown})",
        )


def declare_law(parser: ArgumentParser) -> None:
    """Declare options for the law parameters that are most often varied."""
    declare(parser, stiffness=None, order=None, taps=None)
    parser.add_argument(
        "--gains", choices=("physical", "paper", "unlimited"), help="unit of the gain"
    )
    parser.add_argument("--derivative", help="realisation of the derivative, e.g. gl")
