"""The window of stiffness in which a law stays outside a region at every frequency.

At each frequency the inequality a K² + b K + c > 0 excludes an interval of K, or all but one. The
window is the lowest gap between the excluded intervals in which the loop with the wall is stable
too. Its edges are found by exchange: a finer search at the ends and in the middle adds violated
frequencies to the grid until there are none.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from nodes.laws import CompiledLaw
from nodes.stability.dips import Reals, dips
from nodes.stability.loop_region import Region

_EXCHANGES = 60
_HALVINGS = 40
# largest violation due to rounding, relative to the terms of the inequality
_ROUNDING = 1e-12
_NEAR = np.geomspace(1e-9, 1e-2, 22)  # relative distances from an oscillation frequency
_EMPTY = 1e-9  # narrowest window, relative to the sum of the taps


@dataclass(frozen=True)
class Window:
    """Nominal stiffnesses for which a certificate is valid."""

    low_n_per_m: float  # lower end [N/m]
    # upper end, K_max [N/m]; infinite if every stiffness above `low_n_per_m` is certified
    high_n_per_m: float
    theta: float  # ωT at which the upper end is reached [rad]; π without an upper end


def k_window(
    derivative: CompiledLaw,
    region: Region,
    stable: Callable[[float], bool],
    swings: Sequence[tuple[float, float]] = (),
) -> Window | None:
    """Return the lowest window of K above max(0, −D(1)); None if no K is certified.

    Parameters
    ----------
    derivative : CompiledLaw
        The law without its spring (`nodes.stability.k_max.without_spring`).
    region : Region
        Region of device and world.
    stable : callable
        Whether the loop of one member of the region is stable with a stiffness K [N/m]. The others
        follow, because none of them can cross the unit circle within the window.
    swings : sequence of (float, float)
        K [N/m] and ωT at which that member itself oscillates. They end a gap even if the region is
        so small that the excluded interval lies between the frequencies of the grid.
    """
    floor = max(0.0, -derivative.h1)
    narrow = _EMPTY * (
        sum(map(abs, derivative.taps))
        + sum(abs(b) for s in derivative.sections for b in s[:2])
        + floor
        + 1.0
    )
    # A small region excludes something near these frequencies only.
    swinging = np.outer(
        [at for _, at in swings], np.concatenate([1.0 - _NEAR, [1.0], 1.0 + _NEAR])
    ).ravel()
    theta = np.union1d(
        region.frequencies(derivative),
        swinging[(swinging > 0.0) & (swinging <= math.pi)],
    )
    a, b, c = region.quadratic(derivative, theta)
    for _ in range(_HALVINGS):
        between = _unresolved(theta, a, b, c)
        if not between.size:
            break
        theta, a, b, c = _joined(derivative, region, theta, (a, b, c), between)
    refused: list[float] = []  # middles of gaps in which the loop itself is unstable
    for _ in range(_EXCHANGES):
        gaps = [
            gap
            for gap in _divided(_gaps(theta, a, b, c, floor), swings)
            if gap[1] - gap[0] > narrow
        ]
        gap = next(
            (
                gap
                for gap in gaps
                if not any(gap[0] < middle < gap[1] for middle in refused)
            ),
            None,
        )
        if gap is None:
            return None
        low, high, at = gap
        middle = 0.5 * (low + high) if math.isfinite(high) else 2.0 * low + 1e3
        found = np.concatenate(
            [
                _violated(derivative, region, k, theta, (a, b, c))
                for k in (low, middle, high)
                if k > floor and math.isfinite(k)
            ]
        )
        found = np.setdiff1d(found, theta)
        if found.size:
            theta, a, b, c = _joined(derivative, region, theta, (a, b, c), found)
        elif stable(middle):
            return Window(low, high, at)
        else:
            refused.append(middle)
    return None


def outside(law: CompiledLaw, region: Region) -> bool:
    """Return whether a law is outside a region at every frequency."""
    theta = region.frequencies(law)
    terms = region.quadratic(law, theta)
    return (
        bool(np.all(terms[2] > 0.0))
        and not _violated(law, region, 0.0, theta, terms).size
    )


def _violated(
    derivative: CompiledLaw,
    region: Region,
    stiffness: float,
    theta: Reals,
    terms: tuple[Reals, Reals, Reals],
) -> Reals:
    """Return frequencies of the deepest dips where the inequality fails beyond rounding."""

    def margin(at: Reals) -> Reals:
        # Divided by 1 − cos ωT, with which all terms shrink, it is smooth down to 0.
        a, b, c = region.quadratic(derivative, at)
        return np.asarray(
            ((a * stiffness + b) * stiffness + c) / np.sin(0.5 * at) ** 2,
            dtype=np.float64,
        )

    a, b, c = terms
    at, _ = dips(
        margin, theta, ((a * stiffness + b) * stiffness + c) / np.sin(0.5 * theta) ** 2
    )
    a, b, c = region.quadratic(derivative, at)
    size = np.abs(a) * stiffness**2 + np.abs(b * stiffness) + np.abs(c)
    return at[(a * stiffness + b) * stiffness + c < -_ROUNDING * size]


def _joined(
    derivative: CompiledLaw,
    region: Region,
    theta: Reals,
    terms: tuple[Reals, Reals, Reals],
    more: Reals,
) -> tuple[Reals, Reals, Reals, Reals]:
    extra = region.quadratic(derivative, more)
    whole = np.concatenate([theta, more])
    order = np.argsort(whole)
    a, b, c = (
        np.concatenate([old, new])[order] for old, new in zip(terms, extra, strict=True)
    )
    return whole[order], a, b, c


def _roots(a: Reals, b: Reals, c: Reals) -> tuple[Reals, Reals, Reals]:
    """Return discriminant and sorted roots of a K² + b K + c.

    Without real roots, both are their common real part.
    """
    square = b * b - 4.0 * a * c
    with np.errstate(divide="ignore", invalid="ignore"):
        half = -0.5 * (b + np.copysign(np.sqrt(np.maximum(square, 0.0)), b))
        first = half / a
        second = np.where(half == 0.0, 0.0, c / half)
    return square, np.minimum(first, second), np.maximum(first, second)


def _unresolved(theta: Reals, a: Reals, b: Reals, c: Reals) -> Reals:
    """Return frequencies between neighbours whose excluded intervals are disjoint.

    The interval is continuous in frequency, so the grid misses frequencies between them.
    """
    square, below, above = _roots(a, b, c)
    whole = (a > 0.0) & (square > 0.0)
    with np.errstate(invalid="ignore"):
        apart = (below[1:] > above[:-1]) | (below[:-1] > above[1:])
    wide = np.diff(theta) > 1e-12 * theta[1:]
    jumps = np.flatnonzero(whole[:-1] & whole[1:] & apart & wide)
    return np.asarray(0.5 * (theta[jumps] + theta[jumps + 1]), dtype=np.float64)


def _divided(
    gaps: Sequence[tuple[float, float, float]], swings: Sequence[tuple[float, float]]
) -> list[tuple[float, float, float]]:
    """Return gaps of K, divided where a member of the region oscillates."""
    parts = []
    for low, high, at in gaps:
        inner = sorted({one for one in swings if low < one[0] < high})
        parts += [
            *zip(
                [low, *(k for k, _ in inner)],
                [k for k, _ in inner],
                [where for _, where in inner],
                strict=False,
            )
        ]
        parts.append((inner[-1][0] if inner else low, high, at))
    return parts


def _gaps(
    theta: Reals, a: Reals, b: Reals, c: Reals, floor: float
) -> list[tuple[float, float, float]]:
    """Return the gaps of K above `floor` that no frequency excludes.

    Each is low, high, and the ωT of its upper end.
    """
    square, below, above = _roots(a, b, c)
    if not np.isfinite(np.concatenate([a, b, c])).all():
        return []  # a double overflows
    if np.any((a <= 0.0) & (square < 0.0)) or np.any(
        (a == 0.0) & (b == 0.0) & (c <= 0.0)
    ):
        return []
    inner = (a < 0.0) & (square >= 0.0)
    whole = (a > 0.0) & (square > 0.0)
    linear = a == 0.0
    low = floor
    high = math.inf
    at = math.pi
    if inner.any():
        low = max(low, float(below[inner].max()))
        least = np.flatnonzero(inner)[int(np.argmin(above[inner]))]
        high = float(above[least])
        at = float(theta[least])
    for i in np.flatnonzero(linear & (b != 0.0)):
        crossing = float(-c[i] / b[i])
        if b[i] > 0.0:
            low = max(low, crossing)
        elif crossing < high:
            high = crossing
            at = float(theta[i])
    ends = [
        (float(below[i]), float(above[i]), float(theta[i]))
        for i in np.flatnonzero(whole)
    ]
    gaps = []
    for start, end, where in sorted(ends):
        if end <= low or start >= high:
            continue
        if start > low:
            gaps.append((low, start, where))
        low = max(low, end)
    return [*gaps, (low, high, at)] if low < high else gaps
