"""Lubich's convolution quadrature: generating function of a BDF to the power α, as taps.

T^−α (Σ_{j=1..p} (1 − w)^j / j)^α = Σ c_m w^m (Lubich 1986) has accuracy of order p at low frequency
and the right phase up to a large part of Nyquist. Its cost is the gain there, (Σ 2^j/j)^α·T^−α:
13.9^α times that of GL for p = 6, which reduces the stable stiffness. Starting weights are left out
because they depend on the time since start. It fails for p > 6, where the series no longer decays,
and if cut shorter than p⌈α⌉ + 1 taps, its exact length at whole orders.
"""

from __future__ import annotations

import math
from functools import partial

from nodes.laws import CompiledLaw


def lubich(order: float, taps: int, period: float, degree: int) -> CompiledLaw:
    """D^α as the power α of the backward differentiation formula of degree p."""
    if not 2 <= degree <= 6:
        raise ValueError(
            f"degree = {degree}: Lubich's quadrature takes BDF 2 to 6; beyond 6 the BDF is not"
            " zero-stable and the taps grow without bound, and 1 is gl"
        )
    least = degree * math.ceil(order) + 1
    if taps < least:
        raise ValueError(
            f"taps = {taps}: BDF{degree} of order {order:g} needs at least {least} (p⌈α⌉ + 1, its"
            " length at whole orders); take more taps, a lower p, or gl"
        )
    # fsum rounds once: the built-in sum rounds differently from Python 3.12 on, and taps would
    # differ. Power of a polynomial a_0 + a_1 w + ...: c_m = Σ_j ((α+1) j/m − 1) a_j c_{m−j} / a_0
    # (Euler; J. C. P. Miller).
    polynomial = [
        math.fsum(
            (-1.0) ** i * math.comb(j, i) / j for j in range(max(i, 1), degree + 1)
        )
        for i in range(degree + 1)
    ]
    lead = polynomial[0]
    series = [lead**order]
    for m in range(1, taps):
        terms = (
            ((order + 1.0) * j / m - 1.0) * polynomial[j] * series[m - j]
            for j in range(1, min(degree, m) + 1)
        )
        series.append(math.fsum(terms) / lead)
    gain = float(period) ** -order
    return CompiledLaw(tuple(gain * c for c in series))


bdf2, bdf3, bdf4, bdf5, bdf6 = (
    partial(lubich, degree=degree) for degree in range(2, 7)
)
