"""Grünwald–Letnikov: binomial series of (1 − z⁻¹)^α, cut after n + 1 taps (paper, eq. 5).

The Gamma-ratio form printed in the paper overflows from m = 171 on; the recursion has no such
limit. Truncation leaves a leak, D(1) ≈ (nT)^−α/Γ(1−α): positive for α < 1, negative for 1 < α < 2.
The sum works at all orders and lengths; its phase is that of a pure delay αT/2.
"""

from __future__ import annotations

from nodes.laws import CompiledLaw


def coefficients(order: float, taps: int) -> list[float]:
    """Return the binomial coefficients of (1 − w)^α, by c_m = c_{m−1}(1 − (α+1)/m)."""
    series = [1.0]
    for m in range(1, taps):
        series.append(series[-1] * ((m - 1.0 - order) / m))
    return series


def gl(order: float, taps: int, period: float) -> CompiledLaw:
    """D^α as the Grünwald–Letnikov sum T^−α Σ c_m x[k−m] (paper, eq. 5)."""
    gain = float(period) ** -order
    return CompiledLaw(tuple(gain * c for c in coefficients(order, taps)))
