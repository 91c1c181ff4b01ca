"""Al-Alaoui's map and a continued fraction: s^β ≈ ((8/7T)(z − 1)/(z + 1/7))^β of degree n (Chen & Vinagre 2003).

Three quarters of the backward rectangle and one quarter of the trapezium: a finite gain at Nyquist,
half-way between GL's and Tustin's, and poles in (−1/7, 1). It leaks about as a memory of n² ticks
does. Expanded for the whole of α > 1 it stays stable but is wrong at low frequency, so the integer
part is split off; beyond degree 200 it is not checked.
"""

from __future__ import annotations

from nodes.laws import CompiledLaw
from nodes.laws.derivatives.cfe import mapped_fraction


def al_alaoui_cfe(order: float, taps: int, period: float) -> CompiledLaw:
    """D^α by Al-Alaoui's map and the continued fraction of degree n."""
    return mapped_fraction(order, taps, period, 8.0 / (7.0 * period), 1.0 / 7.0)
