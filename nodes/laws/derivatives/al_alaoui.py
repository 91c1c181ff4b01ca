"""Al-Alaoui's map and a continued fraction: s^β ≈ ((8/7T)(z − 1)/(z + 1/7))^β of degree n.

Three quarters backward rectangle and one quarter trapezium (Chen and Vinagre 2003): a finite gain
at Nyquist, half-way between those of GL and Tustin, and poles in (−1/7, 1). It leaks about as much
as a memory of n² ticks. For α > 1 the integer part is split off, because the expansion of the whole
is stable but wrong at low frequency. Degrees above 200 are not checked.
"""

from __future__ import annotations

from nodes.laws import CompiledLaw
from nodes.laws.derivatives.cfe import mapped_fraction


def al_alaoui_cfe(order: float, taps: int, period: float) -> CompiledLaw:
    """D^α by Al-Alaoui's map and the continued fraction of degree n."""
    return mapped_fraction(order, taps, period, 8.0 / (7.0 * period), 1.0 / 7.0)
