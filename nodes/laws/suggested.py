"""Values that a refusal suggests: three digits, rounded to the side that is accepted."""

from __future__ import annotations

import math
from typing import Final

# significant digits; the measured delay changes the fourth
DIGITS: Final = 3
_MOST_PLACES: Final = 300  # powers of ten that a float has


def rounded_towards(value: float, towards: float) -> float:
    """Return a value rounded to a few digits towards another value."""
    if value == 0.0 or not math.isfinite(value):
        return value
    place = math.floor(math.log10(abs(value))) + 1 - DIGITS
    if abs(place) > _MOST_PLACES:
        return value
    # Both are exact for the usual sizes: 47.4 is 474 / 10, and not 474 * 0.1.
    unit = 10.0 ** abs(place)
    units = value / unit if place > 0 else value * unit
    whole = math.floor(units) if towards < value else math.ceil(units)
    return whole * unit if place > 0 else whole / unit
