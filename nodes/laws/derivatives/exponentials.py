"""Sum of exponentials: GL's memory of N ticks in O(log N) states.

D^β = D·I^{1−β}, and the weights of GL's fractional sum I^{1−β} are moments of a positive density on
(0, 1),

    g_m = (sin πβ/π) ∫ t^{m−β} (1−t)^{β−1} dt
        = (sin πβ/π) ∫ e^{−s(m+1−β)} (1−e^{−s})^{β−1} ds, s > 0.

With s = e^y the trapezium rule converges exponentially in its step, so a handful of exponentials
per decade of memory gives every g_m; the first taps stay exact. All rates slower than the memory
are put on the slowest pole. The difference D removes the leak: beyond N ticks the result becomes a
first difference. ``taps`` is the memory N, at least 8 (below that there is nothing to save) and at
most 10⁶ (the slowest pole is then 10⁻⁷ from the unit circle).
"""

from __future__ import annotations

import math

from nodes.laws import CompiledLaw
from nodes.laws.derivatives.gl import coefficients
from nodes.laws.derivatives.parallel import difference, parallel, split

MIN_MEMORY = 8
_HEAD = 4
_STEP = 0.9
_SLOWEST = 0.05
_FASTEST = 12.0


def exponentials(order: float, taps: int, period: float) -> CompiledLaw:
    """D^α with GL's weights up to a memory of N ticks, as a sum of exponentials."""
    if taps < MIN_MEMORY:
        raise ValueError(
            f"taps = {taps}: a sum of exponentials needs a memory of at least {MIN_MEMORY} ticks;"
            " use gl, which is exact and cheaper at this length"
        )
    whole, fraction = split(order)
    if fraction == 0.0:
        return difference(whole, period)
    # Gain: D^β = (1−w)/T · T^{1−β} Σ g_m w^m; `parallel` supplies the 1/T of every difference.
    gain = float(period) ** (1.0 - fraction)
    density = math.sin(math.pi * fraction) / math.pi
    low = math.log(_SLOWEST / taps)
    high = math.log(_FASTEST / (_HEAD + 1))
    count = math.ceil((high - low) / _STEP)
    rates = [math.exp(high - i * _STEP) for i in range(count + 1)]
    poles = [math.exp(-s) for s in rates]
    weights = [
        density
        * _STEP
        * s
        * math.exp(-s * (1.0 - fraction))
        * (-math.expm1(-s)) ** (fraction - 1.0)
        for s in rates
    ]
    # Slower rates: Σ of the geometric rest of the trapezium rule, whose terms go as s^β.
    weights[-1] /= -math.expm1(-fraction * _STEP)
    exact = coefficients(fraction - 1.0, _HEAD)
    head = [exact[0]] + [
        exact[m] - math.fsum(w * p**m for w, p in zip(weights, poles, strict=True))
        for m in range(1, _HEAD)
    ]
    residues = [gain * w * p for w, p in zip(weights, poles, strict=True)]
    return parallel([gain * h for h in head], poles, residues, whole + 1, period)
