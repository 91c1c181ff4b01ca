"""Parameter types that the laws share: what a stiffness, an order or a number of taps may be.

One place, so that every law refuses the same values with the same limits.
"""

from __future__ import annotations

from typing import Annotated, Literal, TypeAlias

import msgspec

MAX_TAPS = 8192
"""Longest tap vector of any law; at 500 Hz that is 16 s of memory."""

Stiffness: TypeAlias = Annotated[float, msgspec.Meta(gt=0.0)]
Damping: TypeAlias = Annotated[float, msgspec.Meta(ge=0.0)]
Order: TypeAlias = Annotated[float, msgspec.Meta(gt=0.0, lt=4.0)]
Taps: TypeAlias = Annotated[int, msgspec.Meta(ge=2, le=MAX_TAPS)]
Gains: TypeAlias = Literal["physical", "normalised"]


def term_gain(gain: float, order: float, gains: Gains, period: float) -> float:
    """Gain of one fractional term in physical units.

    Parameters
    ----------
    gain : float
        Gain as written: [N s^α/m] when physical, [N s/m] when normalised.
    order : float
        α of the term.
    gains : {"physical", "normalised"}
        ``normalised`` is the seed's convention (fig. 2): the gain is f(ω_N) of the infinite-memory term, which has
        f(ω_N) = (2/T)^(α−1) per unit of physical gain (theory.md §2).
    period : float
        Sampling period T [s].

    Returns
    -------
    float
        Gain [N s^α/m].
    """
    return gain if gains == "physical" else gain * (0.5 * period) ** (order - 1.0)
