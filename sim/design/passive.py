"""The stiffest passive law for the actual delay of a loop.

A passive law is stable whatever the mass, hand or grip. Colgate's condition is linear in the taps
at each frequency; at a fractional delay it is the eigenvalue of a matrix linear in the taps, so it
is convex and homogeneous. The stiffest law is found by cutting planes: a linear program over the
cuts so far, with new cuts where its solution needs most damping. The result is scaled by the
damping it needs, which is bounded between the sampled frequencies too, so passivity is guaranteed.
For d = 1 the result must be 2/(1 + 1/cos(π/(n+3))) (THEORY.md §2).
"""

import math
from dataclasses import dataclass

import numpy as np

from nodes.laws import CompiledLaw
from sim.arrays import Array

_GRID = 1024
_CUTS = 60


@dataclass(frozen=True)
class Passive:
    """A passive law and its proof."""

    # h_0 ... h_n [N/m], shape (n + 1,)
    taps: Array
    h1_n_per_m: float  # H(1) [N/m]
    h_nyquist_n_per_m: float  # H(−1) [N/m]
    # upper bound of the damping the law needs, not above the device's [N s/m]
    damping_needed_n_s_per_m: float
    ratio: float  # H(1)·T/b: 2/(1+2d) for the spring, at most 2/(1+d) (THEORY.md §2)
    # stiffness allowed by the last linear program, which checks fewer frequencies: no passive law
    # of this length and bound on H(−1) is stiffer [N/m]
    bound_n_per_m: float


def stiffest_passive(
    taps: int,
    period: float,
    damping: float,
    delay: tuple[float, float],
    nyquist: float = math.inf,
    tolerance: float = 1e-7,
) -> Passive:
    """Find the passive taps with the largest H(1) at any delay of a range.

    |H(−1)| is at most `nyquist` [N/m]; `tolerance` is the relative gap to the upper bound at which
    the search ends. Raise ValueError for a device without damping or if the linear program fails.
    """
    from scipy.optimize import linprog

    if not damping > 0.0:
        raise ValueError(
            f"damping = {damping!r} N s/m: a device without damping is passive with no stiffness"
            " at all"
        )
    theta = np.linspace(0.0, np.pi, _GRID * max(1, taps // 8) + 1)
    # Whole ticks are included because the damping needed has a kink there.
    whole = np.arange(math.ceil(delay[0]), math.floor(delay[1]) + 1)
    delays = np.union1d(np.linspace(*delay, 5), whole).tolist()
    bases = [_bases(theta, taps, at) for at in delays]
    signs = np.where(np.arange(taps) % 2, -1.0, 1.0)
    # In units of b/T. The limit of a spring bounds the search from the start: |h_m| of a passive
    # law stays below a few b/T.
    top = nyquist * period / damping
    rows = [np.ones(taps)]
    limits = [2.0 / (1.0 + delay[0]) + 1.0]
    if math.isfinite(top):
        rows = [*rows, signs, -signs]
        limits = [*limits, top, top]
    best = np.zeros(taps)
    bound = math.inf
    for _ in range(_CUTS):
        solution = linprog(
            -np.ones(taps),
            A_ub=np.array(rows),
            b_ub=np.array(limits),
            bounds=[(-1e3, 1e3)] * taps,
        )
        if not solution.success or solution.x is None:
            raise ValueError(
                f"taps = {taps}: the linear programme ended with: {solution.message}"
            )
        h = np.asarray(solution.x, dtype=np.float64)
        bound = min(bound, float(h.sum()))
        every = [_needed(h, *basis) for basis in bases]
        scaled = h / max(1.0, *(float(needed.max()) for needed, _ in every))
        if scaled.sum() > best.sum():
            best = scaled
        if best.sum() >= bound * (1.0 - tolerance):
            break
        for needed, slopes in every:
            padded = np.concatenate([[-math.inf], needed, [-math.inf]])
            peaks = np.flatnonzero(
                (needed >= padded[:-2])
                & (needed >= padded[2:])
                & (needed > 1.0 + 1e-12)
            )
            rows += list(slopes[peaks])
            limits += [1.0] * peaks.size
    certain = certain_damping(best * damping / period, period, *delay)
    final = best * damping / period * min(1.0, damping / certain)
    law = CompiledLaw(tuple(final.tolist()))
    ratio = law.h1 * period / damping
    return Passive(
        final,
        law.h1,
        law.h_nyquist,
        min(certain, damping),
        ratio,
        bound * damping / period,
    )


def certain_damping(
    h: Array, period: float, delay: float, latest: float | None = None
) -> float:
    """Bound from above the damping a law needs at a delay, or up to the `latest` [N s/m].

    The bound is the largest of many samples over the frequencies plus the most that may lie between
    samples; over the delays it is exact.

    A trigonometric polynomial of degree N with M > 2N equidistant samples exceeds its largest
    sample in modulus by at most 1/cos(πN/M) (Ehlich and Zeller 1964). The damping needed at a
    fractional delay is a maximum of such polynomials, so the bound is too high by at most 3e-7 of
    the largest |Re T z^−d H/(1−z)|.
    """
    latest = delay if latest is None else latest
    degree = len(h) + math.ceil(latest) + 1
    largest, modulus = 0.0, 0.0
    for part in np.array_split(np.linspace(0.0, np.pi, 2048 * degree + 1), degree):
        for whole in range(
            math.floor(delay), max(math.ceil(latest), math.floor(delay) + 1)
        ):
            soon, cosine, sine, _ = _bases(part, len(h), whole)
            late, *_ = _bases(part, len(h), whole + 1)
            ends = max(delay - whole, 0.0), min(latest - whole, 1.0)
            size = np.hypot(cosine @ h, sine @ h)
            largest = max(largest, float(_most(soon @ h, late @ h, size, ends).max()))
            middle = min(max(0.5, ends[0]), ends[1])
            s = np.maximum(
                *(np.abs((1.0 - phi) * (soon @ h) + phi * (late @ h)) for phi in ends)
            )
            modulus = max(
                modulus,
                float(
                    0.5
                    * (s + np.sqrt(s * s + middle * (1.0 - middle) * size * size)).max()
                ),
            )
    return period * (largest + modulus * (1.0 / math.cos(math.pi / 4096.0) - 1.0))


def _most(soon: Array, late: Array, size: Array, ends: tuple[float, float]) -> Array:
    """Return the largest damping needed at each frequency over fractions φ of a tick.

    φ is between `ends`; `soon` and `late` are Re s at the two whole delays, `size` is |H|. g = ½(s
    + √(s² + φ(1−φ)|H|²)), with s interpolated between the two, is concave in φ: the maximum is at
    its peak or at one of the ends.
    """
    low, high = (
        0.5 * (s + np.sqrt(s * s + phi * (1.0 - phi) * size * size))
        for phi in ends
        for s in [soon + phi * (late - soon)]
    )
    slope = late - soon
    middle = 0.5 * (soon + late)
    with np.errstate(divide="ignore", invalid="ignore"):
        room = size * size - slope * slope
        root = np.sqrt(middle * middle + 0.25 * room)
        # Two forms of the same value, each free of cancellation on its side.
        peak = (
            size
            * size
            * np.where(
                middle < 0.0, 0.125 / (root - middle), 0.5 * (middle + root) / room
            )
        )
        at = 0.5 + 2.0 * peak * slope / (size * size)
        inside = (room > 0.0) & (ends[0] < at) & (at < ends[1])
    return np.asarray(np.where(inside, peak, np.maximum(low, high)))


def _bases(theta: Array, taps: int, delay: float) -> tuple[Array, Array, Array, float]:
    """Return Re s, Re and Im of z^−m per tap and frequency, and φ(1−φ), with T = 1.

    See `damping_needed`.
    """
    whole = math.floor(delay)
    fraction = delay - whole
    m = np.arange(taps)
    # Re{z^−k/(1−z)} = ½ + cos θ + … + cos kθ.
    sums = 0.5 + np.concatenate(
        [
            np.zeros((1, theta.size)),
            np.cumsum(np.cos(np.outer(np.arange(1, taps + whole + 1), theta)), axis=0),
        ]
    )
    real = (1.0 - fraction) * sums[m + whole] + fraction * sums[m + whole + 1]
    angles = np.outer(m, theta)
    return real.T, np.cos(angles).T, -np.sin(angles).T, fraction * (1.0 - fraction)


def _needed(
    h: Array, real: Array, cosine: Array, sine: Array, spread: float
) -> tuple[Array, Array]:
    """Return the damping needed at each frequency and its gradient by the taps."""
    s = real @ h
    if spread == 0.0:
        return s, real
    c = cosine @ h
    d = sine @ h
    root = np.sqrt(s * s + spread * (c * c + d * d))
    safe = np.maximum(root, 1e-300)[:, None]
    slope = 0.5 * (
        real
        + (s[:, None] * real + spread * (c[:, None] * cosine + d[:, None] * sine))
        / safe
    )
    return 0.5 * (s + root), slope
