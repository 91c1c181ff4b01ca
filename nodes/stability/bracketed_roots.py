"""Roots of a real function between bracketing points, all at once and without scipy.

Importing scipy's root finder takes half a second, which a page would wait for its first map.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

_STEPS = 80  # limit of steps; each at least halves a bracket
_CLOSE = 2.0 * np.finfo(np.float64).eps  # relative change at which a guess is a root


def roots_between(
    function: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    low: NDArray[np.float64],
    high: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return a root in each bracket, by Ridders' method (Ridders 1979).

    Parameters
    ----------
    function : callable
        Values of the function at points, shape (n,), as shape (n,).
    low, high : ndarray, shape (n,)
        Ends of the brackets; the function has opposite signs at them.

    Returns
    -------
    ndarray, shape (n,)
        Roots, to the rounding of their position.
    """
    a = np.array(low, dtype=np.float64)
    b = np.array(high, dtype=np.float64)
    at_a = np.array(function(a))
    at_b = np.array(function(b))
    root = np.where(at_a == 0.0, a, b)
    open_ = (at_a != 0.0) & (at_b != 0.0)
    before = np.full_like(a, np.inf)
    for _ in range(_STEPS):
        if not open_.any():
            break
        middle = 0.5 * (a + b)
        at_middle = np.array(function(middle))
        # Under the root is more than zero, because the signs at both ends differ.
        bend = np.sqrt(np.where(open_, at_middle * at_middle - at_a * at_b, 1.0))
        guess = middle + (middle - a) * np.sign(at_a - at_b) * at_middle / bend
        guess = np.clip(guess, np.minimum(a, b), np.maximum(a, b))
        at_guess = np.array(function(guess))
        for point, value in ((middle, at_middle), (guess, at_guess)):
            # Each point that lies inside the bracket replaces the end of its own sign.
            inside = open_ & (a <= point) & (point <= b)
            left = inside & (np.sign(value) == np.sign(at_a))
            right = inside & ~left
            a = np.where(left, point, a)
            at_a = np.where(left, value, at_a)
            b = np.where(right, point, b)
            at_b = np.where(right, value, at_b)
        root = np.where(open_, guess, root)
        # A guess that stays where it was is a root; its bracket may still be wide on one side.
        open_ &= (at_guess != 0.0) & (np.abs(guess - before) > _CLOSE * np.abs(guess))
        before = guess
    return root
