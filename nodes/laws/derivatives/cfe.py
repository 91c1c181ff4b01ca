"""Continued fractions of ((z − 1)/(z + a))^β without expanding a polynomial.

The n-th convergent is the [n/n] Padé approximant at z = ∞. Because ((u − 1)/(u + 1))^β, 0 < β < 1,
is a Stieltjes function,

    ((u − 1)/(u + 1))^β = 1 − (sin πβ/π) ∫ (1−t)^β (1+t)^−β /(u − t) dt, t from −1 to 1,

that approximant is the Gauss–Jacobi rule of the integral: its poles are the nodes, real, simple and
inside the interval, its residues the weights. So it is stable for every n, and free from the
rounding errors of expanded polynomials beyond n ≈ 20. For β > 1 the weight is not integrable and
one pole leaves the interval; so the whole of α > 1 must not be expanded (`whole_order` shows it),
and the integer part is split off.
"""

from __future__ import annotations

import math

from nodes.laws import CompiledLaw
from nodes.laws.derivatives.parallel import difference, parallel, split

MAX_DEGREE = 200


def mapped_fraction(
    order: float, taps: int, period: float, gain: float, left: float
) -> CompiledLaw:
    """Realise D^α from s ≈ g (z − 1)/(z + a): k backward differences and a convergent of s^β."""
    degree = taps - 1
    if degree > MAX_DEGREE:
        raise ValueError(
            f"taps = {taps}: a continued fraction is checked up to {MAX_DEGREE + 1} (degree"
            f" {MAX_DEGREE}); its memory grows as n² ticks, so take fewer, or exponentials for a"
            " longer memory"
        )
    whole, fraction = split(order)
    if fraction == 0.0:
        return difference(whole, period)
    from scipy.special import roots_jacobi

    nodes, weights = roots_jacobi(degree, fraction, -fraction)
    # u in (−1, 1) ↔ z in (−a, 1); a Padé approximant at infinity is invariant under z = centre +
    # half·u.
    half = 0.5 * (1.0 + left)
    scale = float(gain) ** fraction
    poles = [1.0 - half * (1.0 - float(t)) for t in nodes]
    residues = [
        -math.sin(math.pi * fraction) / math.pi * half * float(w) * scale
        for w in weights
    ]
    return parallel([scale], poles, residues, whole, period)


def whole_order(
    order: float, degree: int, left: float
) -> tuple[list[complex], list[complex]]:
    """Return zeros and poles of the whole ((z − 1)/(z + a))^α, unstable for α > 1 (see above)."""
    if degree > 12:
        raise ValueError(
            f"degree = {degree}: the expanded form is accurate up to 12 only; take a lower degree"
        )
    import numpy as np

    # ((u+1)/(u−1))^a = 1 + 2a/(u − a + (a²−1)/(3u + (a²−4)/(5u + ...))), a = −α: numerators and
    # denominators by the three-term recursion of continued fractions.
    a = -order
    top = [np.poly1d([1.0]), np.poly1d([1.0, a])]
    bottom = [np.poly1d([1.0]), np.poly1d([1.0, -a])]
    for j in range(1, degree):
        for series in (top, bottom):
            series.append(
                np.poly1d([2.0 * j + 1.0, 0.0]) * series[-1]
                + (a * a - j * j) * series[-2]
            )
    half = 0.5 * (1.0 + left)
    zeros, poles = (
        [complex(1.0 - half * (1.0 - u)) for u in series[-1].roots]
        for series in (top, bottom)
    )
    return zeros, poles
