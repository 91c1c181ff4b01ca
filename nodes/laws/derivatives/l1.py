"""L1: Caputo's integral, exact for a deflection that is linear between samples.

D^β x[k] ≈ T^−β/Γ(2−β) Σ_m ((m+1)^{1−β} − m^{1−β}) (x[k−m] − x[k−m−1]) (Oldham and Spanier 1974):
exact for a ramp, error O(T^{2−β}), and without a leak by construction. For α = k + β > 1 it follows
k backward differences. For α just above a whole number it subtracts the oldest sample, x[k] −
x[k−n] for β → 0, so the memory must then outlast the contact. It fails if the k differences leave
it less than one interval to integrate over (n + 1 < k + 2).
"""

from __future__ import annotations

import math

from nodes.laws import CompiledLaw
from nodes.laws.derivatives.parallel import difference, differenced, split


def l1(order: float, taps: int, period: float) -> CompiledLaw:
    """D^α by the L1 formula over n + 1 samples."""
    whole, fraction = split(order)
    least = whole + 2 if fraction > 0.0 else whole + 1
    if taps < least:
        raise ValueError(
            f"taps = {taps}: L1 of order {order:g} needs at least {least}: {whole} differences and"
            " one interval; take more taps or a lower order"
        )
    if fraction == 0.0:
        return difference(whole, period)
    intervals = taps - whole - 1
    gain = float(period) ** -fraction / math.gamma(2.0 - fraction)
    # (m+1)^γ − m^γ, γ = 1 − β, by expm1: the plain difference loses digits at large m
    power = 1.0 - fraction
    weights = [1.0] + [
        m**power * math.expm1(power * math.log1p(1.0 / m)) for m in range(1, intervals)
    ]
    series = (
        [weights[0]]
        + [weights[m] - weights[m - 1] for m in range(1, intervals)]
        + [-weights[-1]]
    )
    return differenced([gain * c for c in series], whole, period)
