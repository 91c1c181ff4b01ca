"""Fractional orders as backward differences and parallel sections with simple real poles.

Recursive approximations of s^α are good for 0 < α < 1 and bad beyond (a continued fraction of
Tustin's map is even unstable for α > 1), so α = k + β is realised as k backward differences of D^β.
The loop renders taps and sections in parallel, not in series, so the differences are multiplied in
here by partial fractions. All poles of the realisations in this package are real. Pairs of them
share one second-order section, slow with fast, because two poles near z = 1 in one direct form
would lose half the digits.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence

from nodes.laws import CompiledLaw
from nodes.laws.derivatives.gl import coefficients

_SMALL = 1e-2
_PAIRED = 0.1
_EPSILON = 1e-18

Section = tuple[float, float, float, float]

# relative distance within which an order counts as a whole number
ROUNDING = 16 * sys.float_info.epsilon


def split(order: float) -> tuple[int, float]:
    """Split α into a number of differences and a fraction."""
    nearest = round(order)
    if abs(order - nearest) <= ROUNDING * nearest:
        return nearest, 0.0
    whole = math.floor(order)
    return whole, order - whole


def difference(times: int, period: float) -> CompiledLaw:
    """Return backward differences, ((1 − z⁻¹)/T)^k."""
    gain = float(period) ** -times
    return CompiledLaw(tuple(gain * c for c in coefficients(float(times), times + 1)))


def differenced(taps: Sequence[float], times: int, period: float) -> CompiledLaw:
    """Return a tap vector followed by k backward differences."""
    return CompiledLaw(tuple(_convolve(taps, difference(times, period).taps)))


def parallel(
    direct: Sequence[float],
    poles: Sequence[float],
    residues: Sequence[float],
    times: int,
    period: float,
) -> CompiledLaw:
    """Realise [Σ d_m w^m + Σ r_i w/(1 − p_i w)]·((1 − w)/T)^k, w = z⁻¹, as taps and sections.

    From tick k + 1 on, the differences of a geometric sequence are geometric again, with amplitude
    multiplied by (p − 1)^k p^−k; the deviation of the first ticks goes into the taps. A pole too
    close to zero for that division (|p| < 0.01) is written as taps, because it decays within nine
    of them.
    """
    binomial = difference(times, period).taps
    head = list(direct)
    single: list[tuple[float, float]] = []
    for pole, residue in zip(poles, residues, strict=True):
        if abs(pole) < _SMALL and times > 0:
            value = residue
            m = 1
            while abs(value) > _EPSILON * abs(residue):
                _add(head, m, value)
                value = value * pole
                m = m + 1
        else:
            single.append((pole, residue))
    taps = _convolve(head, binomial) if head else []
    shifted: list[tuple[float, float]] = []
    for pole, residue in single:
        # Amplitude of the tail after k differences, counted from tick 1.
        amplitude = (
            residue * ((1.0 - 1.0 / pole) / period) ** times if times else residue
        )
        for m in range(1, times + 1):
            early = math.fsum(
                binomial[j] * residue * pole ** (m - j - 1) for j in range(m)
            )
            _add(taps, m, early - amplitude * pole ** (m - 1))
        shifted.append((pole, amplitude))
    sections = _paired(shifted, taps)
    return CompiledLaw(tuple(taps), tuple(sections))


def _paired(terms: list[tuple[float, float]], taps: list[float]) -> list[Section]:
    # A w/(1 − pw) = (A/p)/(1 − pw) − A/p: two such terms add up to one section with b0 and b1 only.
    large = sorted(term for term in terms if abs(term[0]) >= _PAIRED)
    sections: list[Section] = [
        (0.0, gain, -pole, 0.0) for pole, gain in terms if abs(pole) < _PAIRED
    ]
    while len(large) > 1:
        (p, a) = large.pop(0)
        (q, b) = large.pop()
        a = a / p
        b = b / q
        _add(taps, 0, -(a + b))
        sections.append((a + b, -(a * q + b * p), -(p + q), p * q))
    sections += [(0.0, gain, -pole, 0.0) for pole, gain in large]
    return sections


def _add(taps: list[float], m: int, value: float) -> None:
    taps.extend([0.0] * (m + 1 - len(taps)))
    taps[m] += value


def _convolve(left: Sequence[float], right: Sequence[float]) -> list[float]:
    result = [0.0] * (len(left) + len(right) - 1)
    for i, a in enumerate(left):
        for j, b in enumerate(right):
            result[i + j] += a * b
    return result
