"""The deepest minima of a function of frequency: a grid, then zooms into its lowest cells."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Reals = NDArray[np.float64]

_DIPS = 8
_ZOOMS = 8
_CELLS = 17


def dips(
    function: Callable[[Reals], Reals], theta: Reals, value: Reals
) -> tuple[Reals, Reals]:
    """Return the positions of a function's deepest minima, and its values there.

    Parameters
    ----------
    function : callable
        Of frequencies ωT, shape (n,) to (n,); infinite values and NaN are skipped.
    theta, value : ndarray, shape (n,)
        A grid that separates the minima, and the function on it.
    """
    value = np.where(np.isnan(value), np.inf, value)
    padded = np.concatenate([[np.inf], value, [np.inf]])
    lowest = np.flatnonzero(
        (value <= padded[:-2]) & (value <= padded[2:]) & np.isfinite(value)
    )
    lowest = lowest[np.argsort(value[lowest])][:_DIPS]
    if not lowest.size:
        return np.empty(0), np.empty(0)
    left = theta[np.maximum(lowest - 1, 0)]
    right = theta[np.minimum(lowest + 1, len(theta) - 1)]
    column = np.arange(len(lowest))
    for _ in range(_ZOOMS):
        cells = np.linspace(left, right, _CELLS)
        values = function(cells.ravel()).reshape(cells.shape)
        values = np.where(np.isnan(values), np.inf, values)
        best = np.argmin(values, axis=0)
        left = cells[np.maximum(best - 1, 0), column]
        right = cells[np.minimum(best + 1, _CELLS - 1), column]
    return np.asarray(cells[best, column]), np.asarray(values[best, column])
