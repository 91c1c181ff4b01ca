"""Least squares with fixed stable poles: poles are chosen, residues fitted.

With n fixed poles, evenly spread over the logarithm of the rate from one tick to ten thousand, the
response is linear in the residues. The best fit to (jω)^β in relative error is then one linear
system, and always stable. The fit covers frequencies up to half of Nyquist; a wider fit would
improve the phase there at the cost of gain at Nyquist. One difference is built in, so there is no
leak. One or two poles are wrong by half everywhere, and more than fourteen only add gain at
Nyquist; both are refused.
"""

from __future__ import annotations

import math

from nodes.laws import CompiledLaw
from nodes.laws.derivatives.parallel import difference, parallel, split

MIN_POLES = 3
MAX_POLES = 14
_SLOWEST = 1e-4
_FASTEST = 2.0
_BAND = (1e-4, 0.5)
_POINTS = 240


def least_squares(order: float, taps: int, period: float) -> CompiledLaw:
    """D^α fitted to (jω)^β over almost four decades up to half of Nyquist."""
    poles_wanted = taps - 1
    if not MIN_POLES <= poles_wanted <= MAX_POLES:
        raise ValueError(
            f"taps = {taps}: the least-squares fit takes {MIN_POLES + 1} to {MAX_POLES + 1} (n + 1"
            " for n poles); fewer are wrong by half over the whole band (use gl), more buy only"
            " gain at Nyquist (use exponentials)"
        )
    whole, fraction = split(order)
    if fraction == 0.0:
        return difference(whole, period)
    import numpy as np

    rates = np.geomspace(_SLOWEST, _FASTEST, poles_wanted)
    poles = np.exp(-rates)
    angle = math.pi * np.geomspace(*_BAND, _POINTS)
    w = np.exp(-1j * angle)
    wanted = (1j * angle) ** fraction
    columns = np.stack(
        [np.ones_like(w), w, *(w / (1.0 - p * w) for p in poles)], axis=1
    )
    relative = (1.0 - w)[:, None] * columns / wanted[:, None]
    system = np.concatenate([relative.real, relative.imag])
    target = np.concatenate([np.ones(_POINTS), np.zeros(_POINTS)])
    scale = np.linalg.norm(system, axis=0)
    solution = (
        np.linalg.lstsq(system / scale, target, rcond=None)[0]
        / scale
        * period ** (1.0 - fraction)
    )
    return parallel(
        [float(c) for c in solution[:2]],
        [float(p) for p in poles],
        [float(r) for r in solution[2:]],
        whole + 1,
        period,
    )
