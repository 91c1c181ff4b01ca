"""Tustin's map and a continued fraction: s^β ≈ ((2/T)(z − 1)/(z + 1))^β of degree n.

The phase is right over most of the band, because the map itself has no delay. The exact function is
infinite at Nyquist, so the gain there grows with the degree like n^{2β} (Chen and Vinagre 2003). It
leaks about as much as a memory of n² ticks. For α > 1 the integer part is split off, because the
expansion of the whole is unstable. Degrees above 200 are not checked.
"""

from __future__ import annotations

from nodes.laws import CompiledLaw
from nodes.laws.derivatives.cfe import mapped_fraction


def tustin_cfe(order: float, taps: int, period: float) -> CompiledLaw:
    """D^α by Tustin's map and the continued fraction of degree n."""
    return mapped_fraction(order, taps, period, 2.0 / period, 1.0)
