"""Tustin's map and a continued fraction: s^β ≈ ((2/T)(z − 1)/(z + 1))^β of degree n (Chen & Vinagre 2003).

Right in phase over most of the band, because the map itself has no delay; but the exact function is
infinite at Nyquist, and the gain there grows without bound with the degree, like n^{2β}. It leaks
about as a memory of n² ticks does. It breaks when expanded for the whole of α > 1 (unstable, so the
integer part is split off) and beyond degree 200 (not checked).
"""

from __future__ import annotations

from nodes.laws import CompiledLaw
from nodes.laws.derivatives.cfe import mapped_fraction


def tustin_cfe(order: float, taps: int, period: float) -> CompiledLaw:
    """D^α by Tustin's map and the continued fraction of degree n."""
    return mapped_fraction(order, taps, period, 2.0 / period, 1.0)
