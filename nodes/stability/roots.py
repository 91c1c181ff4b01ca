"""The largest root of a real polynomial, of two coefficients or of thousands.

Up to a hundred coefficients the companion matrix is fast and accurate. Its cubic cost would take
minutes for 2000 taps, so for long polynomials the roots outside a circle are counted (argument
principle) and the radius is narrowed down. The count is certified: between two neighbouring points
of the circle the polynomial is bounded away from zero by its slope and a bound on its curvature, or
the arc is divided further.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

COMPANION_LIMIT = 100  # highest degree for the companion matrix

_BLOCK = 64
_DEPTH = 30


def largest_root(coefficients: NDArray[np.float64]) -> float:
    """Return the modulus of the largest root."""
    c = np.asarray(coefficients, dtype=np.float64)
    if c.size == 0 or c[0] == 0.0 or not np.isfinite(c).all():
        raise ValueError(
            "coefficients: the leading one must not be zero and all must be finite"
        )
    c = np.trim_zeros(c, "b")
    if c.size <= COMPANION_LIMIT + 1:
        return float(largest_roots(c[None, :])[0])
    return _narrow(c / c[0])


def largest_roots(coefficients: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the moduli of the largest roots of many polynomials of one low degree."""
    c = np.asarray(coefficients, dtype=np.float64)
    degree = c.shape[-1] - 1
    if degree == 0:
        return np.zeros(c.shape[:-1])
    companion = np.zeros((*c.shape[:-1], degree, degree))
    companion[..., 0, :] = -c[..., 1:] / c[..., :1]
    companion[..., np.arange(1, degree), np.arange(degree - 1)] = 1.0
    return np.asarray(
        np.abs(np.linalg.eigvals(companion)).max(axis=-1), dtype=np.float64
    )


def roots_outside(coefficients: NDArray[np.float64], radius: float) -> int | None:
    """Count the roots outside a circle, by a certified winding number; None if undecided."""
    # In w = radius/z, roots outside become zeros inside the unit circle. Logarithms avoid overflow
    # of radius**-2000.
    j = np.arange(len(coefficients), dtype=np.float64)
    size = np.abs(coefficients)
    with np.errstate(divide="ignore"):
        logs = np.log(size) - j * np.log(radius)
    c = np.sign(coefficients) * np.exp(logs - logs.max())
    points = 1 << int(np.ceil(np.log2(16 * len(c))))
    values = np.fft.rfft(c, points)
    slopes = np.abs(np.fft.rfft(j * c, points))
    curvature = float(np.sum(j * j * np.abs(c)))
    rounding = 2.0**-52 * np.log2(points) * float(np.sum(np.abs(c)))
    width = 2.0 * np.pi / points
    left = np.arange(points // 2) * width
    a = values[:-1]
    b = values[1:]
    slope_a = slopes[:-1]
    slope_b = slopes[1:]
    turned = 0.0
    for _ in range(_DEPTH):
        reach = curvature * width * width / 8.0 + rounding
        sure = (np.abs(a) > slope_a * (width / 2.0) + reach) & (
            np.abs(b) > slope_b * (width / 2.0) + reach
        )
        turned += float(np.sum(np.angle(b[sure] * np.conj(a[sure]))))
        if sure.all():
            return round(-turned / np.pi)
        left, a, b, slope_a, slope_b = (
            array[~sure] for array in (left, a, b, slope_a, slope_b)
        )
        nearest = min(np.abs(a).min(), np.abs(b).min())
        if nearest <= 2.0 * rounding:
            return None
        width /= 4.0
        inner = left[:, None] + width * np.arange(1, 4)
        inner_values, inner_slopes = _evaluate(c, np.exp(-1j * inner))
        values = np.column_stack([a, inner_values, b])
        slopes = np.column_stack([slope_a, np.abs(inner_slopes), slope_b])
        left = (left[:, None] + width * np.arange(4)).ravel()
        a = values[:, :-1].ravel()
        b = values[:, 1:].ravel()
        slope_a = slopes[:, :-1].ravel()
        slope_b = slopes[:, 1:].ravel()
    return None


def _evaluate(
    c: NDArray[np.float64], w: NDArray[np.complex128]
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Return Σ c_j w^j and Σ j c_j w^j at a few points, as two small matrix products."""
    blocks = -(-len(c) // _BLOCK)
    padded = np.zeros(blocks * _BLOCK)
    padded[: len(c)] = c
    weighted = padded * np.arange(blocks * _BLOCK)
    flat = w.ravel()
    low = flat[:, None] ** np.arange(_BLOCK)
    high = (flat**_BLOCK)[:, None] ** np.arange(blocks)
    value = np.sum((low @ padded.reshape(blocks, _BLOCK).T) * high, axis=1)
    slope = np.sum((low @ weighted.reshape(blocks, _BLOCK).T) * high, axis=1)
    return value.reshape(w.shape), slope.reshape(w.shape)


def _narrow(c: NDArray[np.float64]) -> float:
    """Return the largest modulus: bracketed by counts, polished, certified by a count."""
    j = np.arange(1, len(c))
    nonzero = c[1:] != 0.0
    # Fujiwara's bound above; the geometric mean of all roots below.
    logs = np.log(np.abs(c[1:][nonzero]))
    high = 2.0 * float(np.max(np.exp(logs / j[nonzero])))
    mean = float(np.exp(np.log(abs(c[-1])) / (len(c) - 1)))
    low = min(mean, high) * (1.0 - 1e-9)
    for radius in (1.0, 0.98, 1.02, 0.9, 1.1, 0.7, 1.5, 0.4, 3.0):
        if low < radius < high:
            count = roots_outside(c, radius)
            if count is None:
                return radius
            low, high = (radius, high) if count else (low, radius)
    while high / low > 1.0 + 1e-12:
        if high / low < 1.01:
            found = _newton(c, low, high)
            if found is not None:
                above = found * (1.0 + 1e-10)
                count = roots_outside(c, above) if above < high else 0
                if not count:
                    return found
                low = above
        radius = float(np.sqrt(low * high))
        count = roots_outside(c, radius)
        if count is None:
            return radius
        low, high = (radius, high) if count else (low, radius)
    return high


def _newton(c: NDArray[np.float64], low: float, high: float) -> float | None:
    """Return the largest modulus in [low, high) that Newton's iteration finds, or None."""
    middle = float(np.sqrt(low * high))
    j = np.arange(len(c), dtype=np.float64)
    scaled = c * np.exp(-j * np.log(middle))
    points = 1 << int(np.ceil(np.log2(16 * len(c))))
    value = np.fft.rfft(scaled, points)
    slope = np.fft.rfft(j * scaled, points)
    step = np.abs(value) / np.maximum(np.abs(slope), 1e-300)
    inner = step[1:-1]
    dips = np.flatnonzero((inner <= step[:-2]) & (inner <= step[2:])) + 1
    deepest = dips[np.argsort(step[dips])][:16]
    starts = np.concatenate([[0, len(step) - 1], deepest])
    w = np.exp(-2j * np.pi * starts / points)
    for _ in range(30):
        value, slope = _evaluate(scaled, w)
        change = value / np.where(slope == 0.0, 1.0, slope)
        # At most a tenth per step, so that a start without a root does not overflow.
        change *= np.minimum(1.0, 0.1 / np.maximum(np.abs(change), 1e-300))
        w = w * (1.0 - change)
        if np.abs(change).min() < 1e-15:
            break
    radii = middle / np.abs(w[np.abs(change) < 1e-13])
    radii = radii[(radii >= low) & (radii < high)]
    return float(radii.max()) if radii.size else None
