"""Oustaloup's filter, discretised: poles and zeros alternating over a logarithmic band.

s^β ≈ ω_h^β Π (s + ω'_i)/(s + ω_i) between ω_b and ω_h (Oustaloup et al. 2000), with n pairs from
Nyquist down, half a decade per pair, at most five decades; more pairs then make it smoother. There
are two discretisations: Tustin's map of each factor, and matched poles and zeros (e^{−ωT}), with
the gain matched in the middle of the band. Below ω_b it leaks ω_b^β. One pair covers no band, and
more than 200 are not checked. Ripple and gain at Nyquist do not vanish with n.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable

from nodes.laws import CompiledLaw
from nodes.laws.derivatives.parallel import difference, parallel, split

MIN_PAIRS = 2
MAX_PAIRS = 200
_DECADES_PER_PAIR = 0.5
_MOST_DECADES = 5.0


def oustaloup_tustin(order: float, taps: int, period: float) -> CompiledLaw:
    """D^α by Oustaloup's filter, each factor through Tustin's map."""
    return _oustaloup(order, taps, period, lambda x: (2.0 - x) / (2.0 + x))


def oustaloup_matched(order: float, taps: int, period: float) -> CompiledLaw:
    """D^α by Oustaloup's filter, with matched poles and zeros."""
    return _oustaloup(order, taps, period, lambda x: math.exp(-x))


def _oustaloup(
    order: float, taps: int, period: float, to_z: Callable[[float], float]
) -> CompiledLaw:
    pairs = taps - 1
    if not MIN_PAIRS <= pairs <= MAX_PAIRS:
        raise ValueError(
            f"taps = {taps}: Oustaloup's filter takes {MIN_PAIRS + 1} to {MAX_PAIRS + 1} (n + 1 for"
            " n pairs of pole and zero); fewer cover no band, more are not checked: use"
            " al_alaoui_cfe or exponentials there"
        )
    whole, fraction = split(order)
    if fraction == 0.0:
        return difference(whole, period)
    span = 10.0 ** min(_DECADES_PER_PAIR * pairs, _MOST_DECADES)
    low = math.pi / span  # ωT of poles and zeros; ω_h is Nyquist, ωT = π
    half = 0.5 * fraction
    zeros = [to_z(low * span ** ((i + 0.5 - half) / pairs)) for i in range(pairs)]
    poles = [to_z(low * span ** ((i + 0.5 + half) / pairs)) for i in range(pairs)]
    middle = math.sqrt(low * math.pi)
    z = cmath.exp(1j * middle)
    gain = (middle / period) ** fraction / abs(
        math.prod((z - a) / (z - p) for a, p in zip(zeros, poles, strict=True))
    )
    residues = [
        gain
        * (p - zeros[i])
        * math.prod((p - zeros[j]) / (p - poles[j]) for j in range(pairs) if j != i)
        for i, p in enumerate(poles)
    ]
    return parallel([gain], poles, residues, whole, period)
