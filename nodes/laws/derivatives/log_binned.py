"""Log-binned long memory: GL's weights averaged over bins that grow with age.

The newest 16 taps are exact; older ones share one value per bin, with eight bins to every doubling
of age (the idea of Ford and Simpson's nested meshes, 2001). The sum of the weights, and so the
leak, is GL's. With running sums it would need 16 + 8 log₂(n/16) multiplications; the loop renders
it with the kernel for taps, at the cost of GL of the same length. For 1 < α < 2 the bins apply to
D^β and a difference follows, which leaves no leak. It is refused for α > 2, where the differences
turn every bin edge into a click when an old corner of the motion passes it, and below 17 + k taps,
where there is nothing to bin.
"""

from __future__ import annotations

import math

from nodes.laws import CompiledLaw
from nodes.laws.derivatives.gl import coefficients
from nodes.laws.derivatives.parallel import difference, differenced, split

_EXACT = 16
_BINS = 8


def bins(taps: int) -> list[tuple[int, int]]:
    """Return the edges of the bins over the memory."""
    edges = [(m, m + 1) for m in range(min(_EXACT, taps))]
    start = _EXACT
    width = _EXACT // _BINS
    while start < taps:
        for _ in range(_BINS):
            if start < taps:
                edges.append((start, min(start + width, taps)))
                start += width
        width *= 2
    return edges


def log_binned(order: float, taps: int, period: float) -> CompiledLaw:
    """D^α as the Grünwald–Letnikov sum with old taps averaged in growing bins."""
    whole, fraction = split(order)
    if whole > 1 and fraction > 0.0:
        raise ValueError(
            f"order = {order:g}: log-binned memory takes orders up to 2; beyond, the edges of the"
            " bins show in the differences. Use exponentials, or gl"
        )
    if taps <= _EXACT + whole:
        raise ValueError(
            f"taps = {taps}: log-binned memory of order {order:g} starts at {_EXACT + whole + 1};"
            " use gl, which is the same below that"
        )
    if fraction == 0.0:
        return difference(whole, period)
    series = coefficients(fraction, taps - whole)
    gain = float(period) ** -fraction
    for first, last in bins(len(series)):
        mean = math.fsum(series[first:last]) / (last - first)
        series[first:last] = [mean] * (last - first)
    return differenced([gain * c for c in series], whole, period)
