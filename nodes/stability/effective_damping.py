"""Effective damping f(ω) of a law, and the device damping that makes it passive (Colgate).

H(z) − H(1) is divisible by 1 − z, so f(ω) = T·Re{D(z)/(1−z)} (paper, eq. 9) is a cosine sum without
a singularity at ω = 0: T·Σ t_j cos((j+1)ωT) with t_j = Σ_{m>j} h_m. Its mean is zero by
construction, so the waterbed (THEORY.md §2) cannot get lost in rounding. A delay adds zeros in
front of the taps; fractions of a tick are exact too.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from nodes.laws import CompiledLaw
from nodes.stability.resonances import resonances

PowerSum = Callable[
    [NDArray[np.float64], NDArray[np.complex128]], NDArray[np.complex128]
]

_ZOOMS = 6


def effective_damping(
    law: CompiledLaw, period: float, omega: NDArray[np.float64], delay: int = 0
) -> NDArray[np.float64]:
    """Return f(ω) = T·Re{(z^{−d} H(z) − H(1))/(1 − z)} [N s/m]: negative where the law damps.

    The loop is strictly passive iff b > H(1)·T/2 + f(ω) for all 0 < ω ≤ ω_N (THEORY.md §2).
    `omega`: 0 ≤ ω ≤ π/T [rad/s], at 0 the limit. `delay`: whole ticks.
    """
    return _effective(
        law, period, np.asarray(omega, dtype=np.float64) * period, delay, _power_sum
    )


def _effective(
    law: CompiledLaw,
    period: float,
    theta: NDArray[np.float64],
    delay: int,
    power_sum: PowerSum,
) -> NDArray[np.float64]:
    w = np.exp(-1j * theta)
    # t_j = Σ_{m>j} h_m, the quotient of the taps by w − 1
    backwards = np.array(law.taps[::-1])
    tails = np.cumsum(backwards)[::-1][1:]
    total = (power_sum(tails, w) + _section_tails(law, w)) * w ** (delay + 1)
    # The delay's effect on the spring: (w^d − 1)/(1 − z) = w + … + w^d.
    for j in range(1, delay + 1):
        total = total + law.h1 * w**j
    return np.asarray(period * total.real, dtype=np.float64)


def damping_needed(law: CompiledLaw, period: float, delay: float = 0.0) -> float:
    """Return the least device damping with which the law is passive in any hand [N s/m].

    For a whole delay this is Colgate's limit, max over ω of T·Re{z^{−d}H/(1−z)}. With a fraction φ
    of a tick, held force and sampled position see different aliases; with s the interpolation
    (1−φ)s_d + φ s_{d+1} of the two whole delays it becomes ½(Re s + √((Re s)² + φ(1−φ)T²|H|²)),
    from the eigenvalue of the lifted loop at each ω.
    """
    return -_lowest(
        law, lambda theta, power_sum: -_needed_at(law, period, delay, theta, power_sum)
    )[1]


def least(law: CompiledLaw, period: float) -> tuple[float, float]:
    """Return frequency [rad/s] and value [N s/m] of the least f(ω), with H(1) as the spring."""
    theta, value = _lowest(
        law, lambda theta, power_sum: _effective(law, period, theta, 0, power_sum)
    )
    return theta / period, value


def _needed_at(
    law: CompiledLaw,
    period: float,
    delay: float,
    theta: NDArray[np.float64],
    power_sum: PowerSum,
) -> NDArray[np.float64]:
    whole = math.floor(delay)
    fraction = delay - whole
    half_spring = 0.5 * period * law.h1
    s = half_spring + _effective(law, period, theta, whole, power_sum)
    if fraction == 0.0:
        return s
    s = (1.0 - fraction) * s + fraction * (
        half_spring + _effective(law, period, theta, whole + 1, power_sum)
    )
    w = np.exp(-1j * theta)
    h = power_sum(np.array(law.taps), w)
    for b0, b1, a1, a2 in law.sections:
        h = h + (b0 + b1 * w) / (1.0 + w * (a1 + w * a2))
    spread = fraction * (1.0 - fraction) * (period * np.abs(h)) ** 2
    return np.asarray(0.5 * (s + np.sqrt(s * s + spread)), dtype=np.float64)


def _section_tails(
    law: CompiledLaw, w: NDArray[np.complex128]
) -> NDArray[np.complex128]:
    """Return the same quotient of the sections, (R(w) − R(1))/(w − 1), exact at w = 1 too."""
    total = np.zeros_like(w)
    for b0, b1, a1, a2 in law.sections:
        gain = (b0 + b1) / (1.0 + a1 + a2)
        above = (gain - b0) - gain * a2 * w
        below = 1.0 + w * (a1 + w * a2)
        total = total + above / below
    return total


def _power_sum(
    c: NDArray[np.float64], w: NDArray[np.complex128]
) -> NDArray[np.complex128]:
    """Return Σ c_j w^j by Horner's scheme over blocks of 64 powers, for thousands of taps."""
    block = min(64, max(1, len(c)))
    blocks = max(1, -(-len(c) // block))
    padded = np.zeros(blocks * block)
    padded[: len(c)] = c
    powers = np.empty((w.size, block), dtype=np.complex128)
    powers[:, 0] = 1.0
    powers[:, 1:] = w.reshape(-1, 1)
    np.cumprod(powers, axis=1, out=powers)
    parts = powers @ padded.reshape(blocks, block).T
    stride = powers[:, -1] * w.ravel()
    total = parts[:, -1]
    for i in range(blocks - 2, -1, -1):
        total = total * stride + parts[:, i]
    return np.asarray(total.reshape(w.shape), dtype=np.complex128)


def _lowest(
    law: CompiledLaw,
    function: Callable[[NDArray[np.float64], PowerSum], NDArray[np.float64]],
) -> tuple[float, float]:
    """Return position and value of the minimum over 0 ≤ θ ≤ π: a grid, then zooms.

    The grid is finer than the fastest cosine.
    """
    theta = np.linspace(0.0, np.pi, max(256, 8 * len(law.taps)) + 1)
    if law.sections:
        # Slow sections act in the lowest decades.
        theta = np.unique(
            np.concatenate(
                [theta, np.geomspace(1e-6, np.pi, 2001)[:-1], resonances(law)]
            )
        )
    # On equal angles from w = 1 to w = −1, a sum of powers is a Fourier transform.
    value = function(
        theta,
        _power_sum if law.sections else lambda c, w: np.fft.rfft(c, 2 * (w.size - 1)),
    )
    padded = np.concatenate([[np.inf], value, [np.inf]])
    dips = np.flatnonzero((value <= padded[:-2]) & (value <= padded[2:]))
    dips = dips[np.argsort(value[dips])][:8]
    left = theta[np.maximum(dips - 1, 0)]
    right = theta[np.minimum(dips + 1, len(theta) - 1)]
    for _ in range(_ZOOMS):
        cells = np.linspace(left, right, 33)
        values = function(cells, _power_sum)
        best = np.argmin(values, axis=0)
        column = np.arange(len(best))
        left = cells[np.maximum(best - 1, 0), column]
        right = cells[np.minimum(best + 1, 32), column]
    values = values[best, column]
    winner = int(np.argmin(values))
    return float(cells[best, column][winner]), float(values[winner])
