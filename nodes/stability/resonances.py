"""Frequencies near the poles of a law's sections, where its response is narrow-band."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from nodes.laws import CompiledLaw

_STEPS = 80  # on either side of a pole
_NARROWEST = 1e-12  # smallest distance of a pole from the unit circle that is resolved


def resonances(law: CompiledLaw) -> NDArray[np.float64]:
    """Return frequencies ωT in (0, π] about each pole of a law's sections [rad].

    The steps away from a pole grow in a constant ratio from a twentieth of its distance from the
    unit circle.
    """
    found = [np.empty(0)]
    for _, _, a1, a2 in law.sections:
        for pole in np.roots([1.0, a1, a2]):
            width = max(1.0 - abs(pole), _NARROWEST)
            away = np.geomspace(0.05 * width, math.pi, _STEPS)
            angle = abs(float(np.angle(pole)))
            found.append(np.concatenate([angle - away, [angle], angle + away]))
    theta = np.unique(np.concatenate(found))
    return np.asarray(theta[(theta > 0.0) & (theta <= math.pi)], dtype=np.float64)
