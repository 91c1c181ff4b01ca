"""Proof of impact stability: Zames–Falb multipliers for a wall that only pushes.

Contact comes and goes, so no pole radius shows whether a drop on a wall settles. If penetration
feeds the law and its force is not clamped, the wall is one static nonlinearity max(p, 0) of slope 0
to 1 around the loop G = z^{−d} H P. If a multiplier M = 1 − Σ m_i w^i with m_i ≥ 0, Σ m_i ≤ 1 has
Re{M (1 + G)} > 0 on the unit circle and the loop in contact is stable, every motion under a
constant pull comes to rest, from any height and at any speed (THEORY.md §19). A linear programme on
a grid finds the multiplier; the result is then proved at every frequency
(`nodes.stability.cosine_sums`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from nodes.laws import CompiledLaw
from nodes.stability.closed_loop import pole_radius
from nodes.stability.cosine_sums import Cosines, Laurent, positive
from nodes.stability.flexible import FlexiblePlant, flexible_radius
from nodes.stability.plant import Plant, held_plant

# the one contact convention that is a static nonlinearity
CONVENTION = "penetration history, force not clamped"
TAPS = 8  # multiplier taps on each side

_ROUNDS = 12


@dataclass(frozen=True)
class LandingProof:
    """Whether every drop settles on a wall of penetration history without clamp.

    Attributes
    ----------
    proven : bool
        True is a proof; False means only that none was found.
    convention : str
        Contact convention of the answer.
    multiplier : tuple of float, shape (2 taps,)
        m_i of w^−taps … w^−1, w^1 … w^taps; empty without a proof.
    margin : float
        Least Re{M (1 + G)} found; not above 0 without a proof.
    why : str
        Why there is no proof; empty with one.
    """

    proven: bool
    convention: str
    multiplier: tuple[float, ...]
    margin: float
    why: str

    def text(self) -> str:
        """Return the verdict in a sentence."""
        if self.proven:
            return f"every drop settles: proven ({self.convention})"
        return f"every drop settles: no proof ({self.convention}): {self.why}"


@dataclass(frozen=True)
class _Loop:
    """1 + G = top / ((1 − w)^free · below): polynomials in w."""

    top: Laurent
    below: Laurent
    free: bool  # whether the device is free: a pole at w = 1

    def sum_of(self, multiplier: Laurent) -> Cosines:
        """Return a cosine sum with the sign of Re{M (1 + G)} at every frequency."""
        product = multiplier * self.top * self.below.conjugate
        return product.real_over_one_less_w() if self.free else product.real()

    def scale(self, theta: Cosines) -> Cosines:
        """Return the divisor that turns these sums into Re{M (1 + G)}: |below|².

        A pole at w = 1 has cancelled.
        """
        return np.asarray(np.abs(self.below.at(theta)) ** 2, dtype=np.float64)


def prove_landing(
    law: CompiledLaw,
    plant: Plant | FlexiblePlant,
    period: float | None = None,
    taps: int = TAPS,
) -> LandingProof:
    """Search for a proof that every drop on a wall settles, without clamping the force.

    Parameters
    ----------
    law : CompiledLaw
        Taps and sections; a law with own code has no proof.
    plant : Plant or FlexiblePlant
        The device and the loop's delay; with positive damping, or held by a hand.
    period : float or None
        Sampling period of a flexible device [s]; a `Plant` has its own.
    taps : int
        Multiplier taps on each side.

    Returns
    -------
    LandingProof
        For this device, delay and hand; any height, any speed, any constant pull.

    Raises
    ------
    ValueError
        For a flexible device without a period.
    """
    if law.evaluate is not None:
        return _none("the law has code of its own")
    if not law.h1 > 0.0:
        return _none(f"H(1) = {law.h1:.6g} N/m: it pulls into the wall")
    if plant.damping == 0.0:
        return _none("the device has no damping")
    if isinstance(plant, Plant) and plant.partner is not None:
        return _none(
            "the law couples two bodies, and the proof is of one that lands on a wall"
        )
    if isinstance(plant, Plant):
        radius = pole_radius(law, plant)
    elif period is None:
        raise ValueError(
            "period: a flexible device has none of its own; give the loop's [s]"
        )
    else:
        radius = flexible_radius(law, period, plant)
    if not radius < 1.0:
        return _none(f"pole radius {radius:.6f}: unstable in contact")
    loop = _loop(law, plant, period)
    return _search(loop, taps)


def _none(why: str, margin: float = -math.inf) -> LandingProof:
    return LandingProof(False, CONVENTION, (), margin, why)


def _loop(
    law: CompiledLaw, plant: Plant | FlexiblePlant, period: float | None
) -> _Loop:
    """Return law, delay and device as polynomials in w."""
    if isinstance(plant, Plant):
        held = held_plant(plant)
        whole = held.whole
        above = np.array(held.numerator)
        below = np.array(held.denominator)
    else:
        whole, above, below = plant.rational(period or math.nan)
    # In z: above / (z^(whole + 1) below), of equal degree; in w, the same after w^(whole + 1).
    path = Laurent(np.asarray(above, dtype=np.float64), whole + 1)
    free = plant.stiffness == 0.0
    if free:
        # divided by 1 − w; the remainder is 0 up to rounding
        below = np.cumsum(below)[:-1]
    top, bottom = law_polynomials(law)
    device = Laurent(np.asarray(below, dtype=np.float64))
    whole_device = device * Laurent(np.array([1.0, -1.0])) if free else device
    return _Loop(whole_device * bottom + path * top, device * bottom, free)


def law_polynomials(law: CompiledLaw) -> tuple[Laurent, Laurent]:
    """Return numerator [N/m] and denominator of a law as polynomials in w."""
    top = Laurent(np.array(law.taps))
    bottom = Laurent(np.array([1.0]))
    for b0, b1, a1, a2 in law.sections:
        own = Laurent(np.array([1.0, a1, a2]))
        top = top * own + Laurent(np.array([b0, b1])) * bottom
        bottom = bottom * own
    return top, bottom


def _search(loop: _Loop, taps: int) -> LandingProof:
    """Maximise the least Re{M (1 + G)} on a grid, refine the grid, and certify the result."""
    from scipy.optimize import linprog

    shifts = [i for i in range(-taps, taps + 1) if i]
    own = loop.sum_of(Laurent(np.array([1.0])))
    shifted = [loop.sum_of(Laurent(np.array([1.0]), i)) for i in shifts]
    size = max(map(len, [own, *shifted]))
    padded = [np.pad(one, (0, size - len(one))) for one in [own, *shifted]]
    table = np.array(padded)
    even = np.linspace(0.0, np.pi, 257)[1:]
    theta = np.union1d(even, np.geomspace(1e-4, np.pi, 257))
    finer = np.linspace(0.0, np.pi, 40 * size + 1)[1:]
    fine = np.union1d(finer, np.geomspace(1e-6, np.pi, 4001))
    fine_table = values_of(table, fine)
    fine_scale = loop.scale(fine)
    margin = -math.inf
    weights = np.zeros(2 * taps)
    for _ in range(_ROUNDS):
        rows = values_of(table, theta) / loop.scale(theta)
        # Unknowns are m and the margin: margin + Σ m_i rows_i ≤ rows_0, Σ m_i ≤ 1.
        matrix = np.column_stack([rows[1:].T, np.ones(len(theta))])
        matrix = np.vstack([matrix, np.append(np.ones(2 * taps), 0.0)])
        objective = np.append(np.zeros(2 * taps), -1.0)
        found = linprog(
            objective,
            A_ub=matrix,
            b_ub=np.append(rows[0], 1.0),
            bounds=[(0.0, 1.0)] * (2 * taps) + [(None, 1.0)],
        )
        if not found.success or found.x is None:
            return _none(f"the linear programme ended with: {found.message}")
        bound = float(found.x[-1])
        if bound <= 0.0:
            return _none("no multiplier of this length", bound)
        weights = np.maximum(found.x[:-1], 0.0)
        weights /= max(1.0, float(weights.sum()))
        everywhere = (fine_table[0] - weights @ fine_table[1:]) / fine_scale
        margin = float(everywhere.min())
        if margin > 0.5 * bound:
            break
        dips = np.flatnonzero(
            (everywhere <= np.append(everywhere[1:], np.inf))
            & (everywhere <= np.append(np.inf, everywhere[:-1]))
        )
        theta = np.union1d(theta, fine[dips[everywhere[dips] < bound]])
    if margin <= 0.0:
        return _none("no multiplier of this length", margin)
    sums = table[0] - weights @ table[1:]
    if positive(sums) is not True:
        return _none(
            "a multiplier was found, and not certified between the frequencies", margin
        )
    return LandingProof(True, CONVENTION, tuple(weights.tolist()), margin, "")


def values_of(table: Cosines, theta: Cosines) -> Cosines:
    """Return several cosine sums, shape (s, n + 1), at some angles: shape (s, t)."""
    return np.asarray(
        table @ np.cos(np.multiply.outer(np.arange(table.shape[1]), theta)),
        dtype=np.float64,
    )
