"""Cosine sums Σ c_j cos jθ, and a proof that one is positive at *every* θ.

A frequency condition on a sampled loop is Re{N(w)} > 0 or Re{N(w)/(1 − w)} > 0 on the unit circle,
w = e^{−jθ}, with real coefficients of N; both are cosine sums (THEORY.md §19). Between two
neighbouring points a sum is above its chord less h²/8 times the bound Σ j² |c_j| of its curvature;
where that does not decide, the cell is divided.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Cosines = NDArray[np.float64]

_DEPTH = 40
_CELLS = 2_000_000  # cells that are checked before the answer is "undecided"


@dataclass(frozen=True)
class Laurent:
    """N(w) = Σ c_k w^(low + k) with real coefficients.

    Attributes
    ----------
    coefficients : ndarray of float, shape (k,)
        c_k, lowest power of w first.
    low : int
        Lowest power of w.
    """

    coefficients: Cosines
    low: int = 0

    def __mul__(self, other: Laurent) -> Laurent:
        """Return the product of both."""
        return Laurent(
            np.convolve(self.coefficients, other.coefficients), self.low + other.low
        )

    def __add__(self, other: Laurent) -> Laurent:
        """Return the sum of both."""
        low = min(self.low, other.low)
        high = max(one.low + len(one.coefficients) for one in (self, other))
        total = np.zeros(high - low)
        for one in (self, other):
            total[one.low - low : one.low - low + len(one.coefficients)] += (
                one.coefficients
            )
        return Laurent(total, low)

    @property
    def conjugate(self) -> Laurent:
        """N(1/w), which is the complex conjugate on the unit circle."""
        return Laurent(
            self.coefficients[::-1].copy(), -(self.low + len(self.coefficients) - 1)
        )

    def at(self, theta: Cosines) -> NDArray[np.complex128]:
        """Return the values at w = e^{−jθ}."""
        powers = self.low + np.arange(len(self.coefficients))
        return np.asarray(
            np.exp(-1j * np.multiply.outer(theta, powers)) @ self.coefficients,
            dtype=np.complex128,
        )

    def real(self) -> Cosines:
        """Return the coefficients of the cosine sum Re{N(w)}."""
        size = max(abs(self.low), abs(self.low + len(self.coefficients) - 1)) + 1
        cosines = np.zeros(size)
        np.add.at(
            cosines,
            np.abs(self.low + np.arange(len(self.coefficients))),
            self.coefficients,
        )
        return cosines

    def real_over_one_less_w(self) -> Cosines:
        """Return the coefficients of the cosine sum Re{N(w)/(1 − w)}, regular at w = 1.

        Re{w^k/(1 − w)} = ½ + Σ_{j=1..−k} cos jθ for k ≤ 0 and −½ − Σ_{j=1..k−1} cos jθ for k ≥ 1.
        """
        size = max(abs(self.low), abs(self.low + len(self.coefficients) - 1)) + 1
        cosines = np.zeros(size)
        for power, coefficient in enumerate(self.coefficients.tolist(), self.low):
            sign, terms = (1.0, -power) if power <= 0 else (-1.0, power - 1)
            cosines[0] += 0.5 * sign * coefficient
            cosines[1 : terms + 1] += sign * coefficient
        return cosines


def one_less_cosine(multiple: int) -> Cosines:
    """Return the coefficients of (1 − cos nθ)/(1 − cos θ), n ≥ 1.

    The sum is n + 2 Σ_{j<n} (n − j) cos jθ.
    """
    cosines = 2.0 * np.arange(multiple, 0.0, -1.0)
    cosines[0] = multiple
    return cosines


def values(cosines: Cosines, theta: Cosines) -> Cosines:
    """Return Σ c_j cos jθ at angles θ [rad]."""
    return np.asarray(
        np.cos(np.multiply.outer(theta, np.arange(len(cosines)))) @ cosines,
        dtype=np.float64,
    )


def positive(cosines: Cosines, rounding: float = 1e-13) -> bool | None:
    """Return whether a cosine sum is above 0 at every θ.

    Parameters
    ----------
    cosines : ndarray of float, shape (n + 1,)
        c_0 ... c_n.
    rounding : float
        Relative error of each coefficient; the sum must be positive despite it.

    Returns
    -------
    bool or None
        True is a proof; False if a value is not above the rounding error; None if too many cells
        stay undecided.
    """
    order = np.arange(len(cosines))
    floor = rounding * float(np.abs(cosines).sum())
    curvature = float(order**2 @ np.abs(cosines))
    left = np.linspace(0.0, np.pi, 8 * len(cosines) + 1)
    width = left[1]
    low = values(cosines, left[:-1])
    high = values(cosines, left[1:])
    left = left[:-1]
    seen = 0
    for _ in range(_DEPTH):
        if min(low.min(), high.min()) <= floor:
            return False
        open_ = np.minimum(low, high) - curvature * width * width / 8.0 <= floor
        if not open_.any():
            return True
        left, low, high = left[open_], low[open_], high[open_]
        seen += 4 * len(left)
        if seen > _CELLS:
            return None
        width /= 4.0
        inner = values(cosines, left[:, None] + width * np.arange(1, 4))
        low = np.column_stack([low, inner]).ravel()
        high = np.column_stack([inner, high]).ravel()
        left = (left[:, None] + width * np.arange(4)).ravel()
    return None
