"""Grünwald–Letnikov with the leak moved into the last tap, so that D(1) = 0.

A constant offset then gives no force. This is clearly better for α > 1 with a short memory, where
the leak would make the wall softer than its K. For α < 1 it makes a constant exact (as if it had
been there for ever) but everything slower than the memory less accurate than plain GL. It fails if
the vector is shorter than the differences it replaces (n + 1 <= ⌈α⌉): then the correction is most
of the result, not the small remainder of a series.
"""

from __future__ import annotations

import math

from nodes.laws import CompiledLaw
from nodes.laws.derivatives.gl import coefficients


def gl_leak_corrected(order: float, taps: int, period: float) -> CompiledLaw:
    """D^α as the Grünwald–Letnikov sum with Σ h_m = 0."""
    least = math.ceil(order) + 1
    if taps < least:
        raise ValueError(
            f"taps = {taps}: leak-corrected GL of order {order:g} needs at least {least}; below"
            " that the correction replaces the derivative. Take more taps, or plain gl"
        )
    series = coefficients(order, taps)
    series[-1] = -math.fsum(series[:-1])
    gain = float(period) ** -order
    return CompiledLaw(tuple(gain * c for c in series))
