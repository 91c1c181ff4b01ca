"""Two coupled devices in any two hands: Colgate's condition for a two-port.

The forces on both devices are F = M(z)·x of both sampled positions, each row a law at its own
delays,

    M = [[ψ₁₁ H₁, −ψ₁₂ H₁], [−ψ₂₁ H₂, ψ₂₂ H₂]],   ψ = (1 − φ) w^i + φ w^(i+1) for d = i + φ ticks,
    w = e^{−jθ}, θ = ωT.

With the forces held, whatever passive hands hold the devices, the loop is passive if for all 0 < θ
≤ π the matrix

    diag(b₁, b₂) − T/(2 (1 − cos θ)) · ½[(1 − w) M + ((1 − w) M)*] − T²/(8 (1 − cos θ)) Σ_i E_i/b_i

is positive definite. E_i, 0 if the delays of a row are whole, is the variance over the aliases of
the force that changes within a tick on device i, as a form in both positions (THEORY.md §17). For
one device this is Colgate's condition, and for one law in the middle it gives the discs of
`nodes.stability.loop_region`. At θ → 0 it needs H₁(1) = H₂(1): two different springs on one path
generate energy at any speed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nodes.laws import CompiledLaw
from nodes.stability.resonances import resonances

_ZOOMS = 8
_SOFTEST = 1e-9  # relative difference of the two H(1) that counts as zero


@dataclass(frozen=True)
class TwoHands:
    """Two laws, and the delay with which each sees each position.

    Attributes
    ----------
    laws : tuple of CompiledLaw
        Law of the first device, and of the second.
    delays : tuple of tuple of float
        By law, then by position: from the sample of that position to the force taking effect, whole
        or fractional [ticks].
    """

    laws: tuple[CompiledLaw, CompiledLaw]
    delays: tuple[tuple[float, float], tuple[float, float]]

    @classmethod
    def in_the_middle(cls, law: CompiledLaw, first: float, second: float) -> TwoHands:
        """Return one law between the devices, reaching them after `first` and `second` ticks."""
        return cls((law, law), ((first, first), (second, second)))

    @classmethod
    def law_each(
        cls,
        laws: tuple[CompiledLaw, CompiledLaw],
        there: float,
        back: float,
        own: tuple[float, float] = (0.0, 0.0),
    ) -> TwoHands:
        """Return a law at each device, on its own position and the other's.

        Parameters
        ----------
        laws : tuple of CompiledLaw
            Law of the first device and of the second.
        there, back : float
            Delay of the first position to the second device, and of the second's to the first
            [ticks].
        own : tuple of float
            Delay of each loop itself [ticks].
        """
        return cls(laws, ((own[0], own[0] + back), (own[1] + there, own[1])))


def damping_share(
    coupling: TwoHands, period: float, damping: tuple[float, float]
) -> float:
    """Return the share of both devices' damping that the coupling uses.

    Below 1 it is passive for any two hands.

    Parameters
    ----------
    coupling : TwoHands
        Laws and delays.
    period : float
        Sampling period T [s].
    damping : tuple of float
        Viscous damping of both devices [N s/m].

    Returns
    -------
    float
        Largest eigenvalue over all frequencies [1]; infinite if both sides render different
        stiffnesses, or if an undamped device would need damping.
    """
    first, second = (law.h1 for law in coupling.laws)
    if abs(first - second) > _SOFTEST * max(abs(first), abs(second)):
        return math.inf
    length = max(len(law.taps) for law in coupling.laws) + math.ceil(
        max(max(row) for row in coupling.delays)
    )
    grid = [
        np.linspace(0.0, np.pi, 16 * length + 257)[1:],
        np.geomspace(1e-4, np.pi, 801),
    ]
    grid += [sharp[sharp >= 1e-4] for sharp in map(resonances, coupling.laws)]

    def share(theta: NDArray[np.float64]) -> NDArray[np.float64]:
        return _share(coupling, period, damping, theta)

    return float(_highest(share, np.unique(np.concatenate(grid))))


def _share(
    coupling: TwoHands,
    period: float,
    damping: tuple[float, float],
    theta: NDArray[np.float64],
) -> NDArray[np.float64]:
    w = np.exp(-1j * theta)
    # (1 − w)/(2 (1 − cos θ)) = 1/(1 − w̄): this form avoids cancellation.
    sampled = period / (1.0 - np.conj(w))
    rows = [sampled * law.response(1.0 / w) for law in coupling.laws]
    (d11, d12), (d21, d22) = coupling.delays
    own = [(rows[0] * lag(w, d11)).real, (rows[1] * lag(w, d22)).real]
    across = -0.5 * (rows[0] * lag(w, d12) + np.conj(rows[1] * lag(w, d21)))
    with np.errstate(divide="ignore", invalid="ignore"):
        for i, (row, (first, second)) in enumerate(
            zip(rows, coupling.delays, strict=True)
        ):
            # Additional need of a force that changes within a tick, of the positions x₁ and −x₂.
            size = np.abs(row) ** 2 / (4.0 * damping[i])
            own[0] = own[0] + size * _spread(w, first, first).real
            own[1] = own[1] + size * _spread(w, second, second).real
            across = across - size * _spread(w, first, second)
        a, b = own[0] / damping[0], own[1] / damping[1]
        c = np.abs(across) ** 2 / (damping[0] * damping[1])
        found = 0.5 * (a + b) + np.sqrt(0.25 * (a - b) ** 2 + c)
    return np.asarray(np.where(np.isnan(found), np.inf, found), dtype=np.float64)


def lag(w: NDArray[np.complex128], delay: float) -> NDArray[np.complex128]:
    """Return ψ, the mean over the aliases of a lag of `delay` ticks; a negative one is ahead."""
    whole = math.floor(delay)
    late = delay - whole
    return (
        w**whole if late == 0.0 else (1.0 - late) * w**whole + late * w ** (whole + 1)
    )


def _spread(
    w: NDArray[np.complex128], first: float, second: float
) -> NDArray[np.complex128]:
    """Return the covariance over the aliases of two lags, the first conjugated."""
    return lag(w, second - first) - np.conj(lag(w, first)) * lag(w, second)


def _highest(
    function: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    grid: NDArray[np.float64],
) -> float:
    """Return the largest value: the highest cells of a grid, each zoomed into."""
    value = function(grid)
    padded = np.concatenate([[-np.inf], value, [-np.inf]])
    peaks = np.flatnonzero((value >= padded[:-2]) & (value >= padded[2:]))
    peaks = peaks[np.argsort(-value[peaks])][:8]
    left, right = (
        grid[np.maximum(peaks - 1, 0)],
        grid[np.minimum(peaks + 1, len(grid) - 1)],
    )
    best = float(value.max())
    for _ in range(_ZOOMS):
        cells = np.linspace(left, right, 17)
        values = function(cells.ravel()).reshape(cells.shape)
        at, column = np.argmax(values, axis=0), np.arange(len(peaks))
        best = max(best, float(values.max()))
        left, right = (
            cells[np.maximum(at - 1, 0), column],
            cells[np.minimum(at + 1, 16), column],
        )
    return best


def k_max_two_hands(
    coupling_at: Callable[[float], TwoHands],
    period: float,
    damping: tuple[float, float],
    highest: float = 1e9,
) -> float | None:
    """Return the largest nominal stiffness at which a coupling is passive for any two hands.

    Parameters
    ----------
    coupling_at : callable
        From a nominal stiffness K [N/m] to the coupling.
    period : float
        Sampling period T [s].
    damping : tuple of float
        Viscous damping of both devices [N s/m].
    highest : float
        End of the search [N/m].

    Returns
    -------
    float or None
        K [N/m]; None if no stiffness is passive. The condition is convex in K, so there is one
        interval only.
    """

    def excess(stiffness: float) -> float:
        return damping_share(coupling_at(stiffness), period, damping) - 1.0

    softest = 1e-6
    # The share is convex in K: if the derivative part alone needs too much, a stiffer spring may
    # need less.
    tried: list[float] = [softest, *np.geomspace(1e-2, highest, 121).tolist()]
    start = next((k for k in tried if excess(k) < 0.0), None)
    if start is None:
        return None
    low, high = start, max(2.0 * start, 1.0)
    while excess(high) < 0.0:
        low, high = high, 2.0 * high
        if high > highest:
            return math.inf
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if excess(middle) < 0.0 else (low, middle)
        if high - low < 1e-10 * high:
            break
    return low
