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


# of any quantity that is not 0; and 1e12 at most: squares and quotients of both stay numbers
_LEAST = 1e-12


def positive(text: str) -> float:
    """Read a positive, finite number."""
    value = number(text)
    if not value > 0.0:
        raise argparse.ArgumentTypeError(f"{text}: must be positive")
    return value


def not_negative(text: str) -> float:
    """Read a finite number that is at least 0."""
    value = number(text)
    if not value >= 0.0:
        raise argparse.ArgumentTypeError(f"{text}: must be at least 0")
    return value


def above_zero(text: str) -> float:
    """Read a number above 0, which may be inf."""
    return math.inf if text.strip().lower() in ("inf", "infinity") else positive(text)


def interval(text: str) -> tuple[float, float]:
    """Read ``low..high``, or one number that is both."""
    low, _, high = text.partition("..")
    ends = not_negative(low), not_negative(high or low)
    if ends[0] > ends[1]:
        raise argparse.ArgumentTypeError(f"{text}: the lower end comes first")
    return ends


def number(text: str) -> float:
    """Read a finite number of either sign, or 0."""
    try:
        value = float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number") from None
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text}: must be finite")
    if value and not _LEAST <= abs(value) <= 1.0 / _LEAST:
        raise argparse.ArgumentTypeError(f"{text}: must be between {_LEAST:g} and {1.0 / _LEAST:g}")
    return value


def between(low: float, high: float, zero: bool = False) -> Callable[[str], float]:
    """Read a number within the limits of what is a device or a loop: beyond them figures overflow, or fill the memory."""

    def read(text: str) -> float:
        """Read one."""
        value = not_negative(text) if zero else positive(text)
        if value and not low <= value <= high:
            raise argparse.ArgumentTypeError(
                f"{text}: must be between {low:g} and {high:g}{', or 0' if zero else ''}"
            )
        return value

    return read


def whole(low: int, high: int) -> Callable[[str], int]:
    """Read a whole number within limits."""

    def read(text: str) -> int:
        """Read one."""
        try:
            value = int(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"{text[:40]!r} is not a whole number") from None
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{value:d}: must be between {low} and {high}")
        return value

    return read


COUNT = whole(1, 100_000)
ROUNDS = whole(1, 10_000)  # of a benchmark
PORT = whole(0, 65_535)  # 0: a free one
SEED = whole(0, 2**32 - 1)
SECONDS = between(1e-3, 86_400.0)  # of a run


QUANTITIES: dict[str, tuple[Callable[[str], Any], str]] = {  # how each is read, and what it is
    "mass": (between(1e-6, 1e6), "moving mass of the device [kg]"),
    "damping": (between(1e-9, 1e9, zero=True), "viscous damping of the device [N s/m]"),
    "delay": (between(1e-9, 1000.0, zero=True), "delay of the loop [ticks], fractions allowed"),
    "rate": (between(1.0, 1e5), "rate of the loop [Hz]"),
    "hand": (between(1e-9, 1e9, zero=True), "stiffness of a hand on the device [N/m]"),
    "stiffness": (between(1e-9, 1e9), "nominal K of the law [N/m]"),
    "gain": (between(1e-9, 1e9, zero=True), "damping gain B of the law [N s/m, or N s^α/m]"),
    "order": (positive, "order α of the law"),
    "taps": (whole(1, 100_000), "length of the law's tap vector, n + 1"),
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
            f"--{name}",
            type=read,
            default=default,
            help=text if shown is None else f"{text} (default: {shown})",
        )


def declare_law(parser: argparse.ArgumentParser) -> None:
    """Declare the parameters of a law that are most often varied."""
    declare(parser, stiffness=None, order=None, taps=None)
    parser.add_argument(
        "--gains", choices=("physical", "paper", "unlimited"), help="unit of the gain"
    )
    parser.add_argument("--derivative", help="realisation of the derivative, e.g. gl")
