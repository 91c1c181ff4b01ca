"""Parameter types shared by the laws: valid stiffnesses, orders and numbers of taps."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Annotated, Literal, TypeAlias

import msgspec

from nodes.laws.derivatives.gl import coefficients

MAX_TAPS = 8192  # longest tap vector of any law: 16 s of memory at 500 Hz

Stiffness: TypeAlias = Annotated[float, msgspec.Meta(gt=0.0)]
Damping: TypeAlias = Annotated[float, msgspec.Meta(ge=0.0)]
Order: TypeAlias = Annotated[float, msgspec.Meta(gt=0.0, lt=4.0)]
Taps: TypeAlias = Annotated[int, msgspec.Meta(ge=2, le=MAX_TAPS)]
Gains: TypeAlias = Literal["physical", "paper", "unlimited"]


GAINS: Mapping[str, Mapping[str, str]] = MappingProxyType(
    {
        "physical": {
            "unit": "N s^α/m",
            "gain": "B",
            "take": "B_α was identified, or is given in SI units",
        },
        "unlimited": {
            "unit": "N s/m",
            "gain": "B (T/2)^(α−1)",
            "take": "orders are compared: with endless memory |D(−1)| is that of a damper B",
        },
        "paper": {
            "unit": "N s/m",
            "gain": "B (T/2)^(α−1) · 2^α / Σ (−1)^m c_m",
            "take": "the paper's figures: the same, for the memory that is there",
        },
    }
)
"""Values of ``gains``: unit of the gain, gain of D^α in SI units, when to take it."""


def term_gain(
    gain: float, order: float, gains: Gains, period: float, taps: int
) -> float:
    """Return the gain of one fractional term in physical units."""
    if gains == "physical":
        return gain
    unlimited: float = gain * (0.5 * period) ** (order - 1.0)
    if gains == "unlimited":
        return unlimited
    return float(unlimited * 2.0**order / alternating_sum(order, taps))


def alternating_sum(order: float, taps: int) -> float:
    """Return Σ (−1)^m c_m of the Grünwald–Letnikov coefficients, i.e. T^α D(−1).

    It tends to 2^α with the number of taps (THEORY.md §1).
    """
    series = coefficients(order, taps)
    return sum(series[0::2]) - sum(series[1::2])
