"""Stable for every sequence of delays within a range: a certificate, not a replay.

A delay that jitters can be worse than each of its values, and no pole radius tells. Each tick the loop is multiplied by one of
a family of matrices; it is stable for every sequence iff the joint spectral radius of the family is below 1 (THEORY.md §10).
The family is enclosed by a few matrices: within a tick the force's share of the motion moves along a convex curve, which lies
in the polygon of its tangents. A norm is sought in which each of them shrinks (an ellipsoid, by gradients); where one tick
does not shrink, all products that begin with it are followed until they do. When all are closed, every sequence is a chain of
words that shrink: stable, with a rate. A product that grows by itself is a sequence of delays that the loop does not survive.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from nodes.stability.closed_loop import state_matrix
from nodes.stability.plant import Plant, held_step

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from nodes.laws import CompiledLaw

    Matrix = NDArray[np.float64]


MAX_STATES = 40
"""Longest state that a norm is sought for; a law of n + 1 taps has n + 3 and the delay's ticks."""

_SEGMENTS = 2
_WORDS = 60_000
_DEPTH = 60
_MARGIN = 1e-9
_ENOUGH = 1e-6


@dataclass(frozen=True)
class EveryDelay:
    """Whether a loop is stable for every sequence of delays.

    Attributes
    ----------
    stable : bool or None
        True with a certificate, False with a sequence that grows; None when neither was found.
    rate : float or None
        Factor per tick by which every motion shrinks at least, in the norm of the certificate; None without one.
    words : int
        Words of the certificate: each is a run of delays over which the norm shrinks.
    longest : int
        Longest of them [ticks].
    growing : tuple of float
        Delays of a sequence that, repeated, grows [ticks]; empty without one.
    growth : float
        Its factor per tick; the largest found, growing or not.
    """

    stable: bool | None
    rate: float | None
    words: int
    longest: int
    growing: tuple[float, ...]
    growth: float


def every_delay(law: CompiledLaw, plant: Plant, delay: tuple[float, float], rate: float = 1.0) -> EveryDelay:
    """Certify a loop for every sequence of delays of a range, or find one that it does not survive.

    Parameters
    ----------
    law : CompiledLaw
        Taps, and sections if any.
    plant : Plant
        The device and its loop; the range takes the place of its delay.
    delay : tuple of float, shape (2,)
        Shortest and longest delay, at most one tick apart: then no force overtakes another [ticks].
    rate : float
        Factor per tick that every motion must shrink by; 1 asks for stability alone.

    Returns
    -------
    EveryDelay
        Certificate or counterexample.

    Raises
    ------
    ValueError
        When the range is out of order or wider than a tick, or the law is too long for a norm to be sought.
    """
    import numpy as np

    low, high = delay
    if not 0.0 <= low <= high <= low + 1.0:
        raise ValueError(f"delay {low:g}..{high:g} ticks: expected low to high, at most one tick apart")
    ticks = _Ticks(law, plant, delay)
    if ticks.size > MAX_STATES:
        raise ValueError(f"law: {ticks.size} states, at most {MAX_STATES} are certified; shorten the law")
    growth, growing = _worst_word(ticks, delay)
    if growth >= rate:
        return EveryDelay(False, None, 0, 0, growing, growth)
    hull = ticks.hull() / rate
    norm = _norm(hull)
    balanced = norm @ hull @ np.linalg.inv(norm)
    closed = _close(balanced)
    if closed is None:
        return EveryDelay(None, None, 0, 0, (), growth)
    words, longest, slowest = closed
    return EveryDelay(True, rate * slowest, words, longest, (), growth)


class _Ticks:
    """Matrices of one tick: by the delays of two forces that follow each other, and a hull of those of all delays."""

    def __init__(self, law: CompiledLaw, plant: Plant, delay: tuple[float, float]) -> None:
        import numpy as np

        period = plant.period
        self._plant = replace(plant, delay=0.0)
        self._low, self._high = delay
        self._first = math.floor(delay[0])
        # Of the forces on their way, that of age `depth` arrives in each tick, or may; where the range crosses a whole tick
        # the one after it may arrive late in the same tick.
        self._depth = self._first + 1 if delay[1] > self._first + 1 else self._first
        base = state_matrix(law, replace(plant, delay=float(self._depth)))
        self.size = len(base)
        newest = self.size - 1 - self._depth
        rows = [base[newest].copy(), *np.eye(self.size)[newest:]]
        self._forces = rows
        _, (a11, a12, a21, a22), _, _ = held_step(self._plant)
        base[:2] = 0.0
        base[0, :2] = a11, a12 / period
        base[1, :2] = a21 * period, a22
        base[:2] += np.outer(self._share(0.0), rows[self._depth + 1])
        self._base = base

    def _share(self, s: float) -> Matrix:
        """Motion per force that acts from s to the end of a tick, in the units of the state: a convex curve."""
        import numpy as np

        if s >= 1.0:
            return np.zeros(2)
        mass, period = self._plant.mass, self._plant.period
        _, _, (g1, g2), _ = held_step(replace(self._plant, period=period * (1.0 - s)))
        return np.array([g1, g2 * period]) * mass / period**2

    def _polygon(self, low: float, high: float) -> list[Matrix]:
        """Corners of the tangents of that curve: the curve lies in their hull."""
        import numpy as np

        if high <= low:
            return [self._share(low)]
        plant = self._plant

        def slope(s: float) -> Matrix:
            # Against s: velocity, and acceleration = force less what damping and hand take.
            g1, g2 = self._share(s)
            ratio = plant.period / plant.mass
            return np.array([-g2, -(1.0 - plant.damping * ratio * g2 - plant.stiffness * plant.period * ratio * g1)])

        knots = np.linspace(low, high, _SEGMENTS + 1).tolist()
        corners = [self._share(low)]
        for left, right in itertools.pairwise(knots):
            p, q, u, v = self._share(left), self._share(right), slope(left), slope(right)
            corners.append(p + np.linalg.solve(np.column_stack([u, -v]), q - p)[0] * u)
        return [*corners, self._share(high)]

    def _matrix(self, early: Matrix, late: Matrix | None) -> Matrix:
        import numpy as np

        forces, depth = self._forces, self._depth
        step = self._base.copy()
        step[:2] += np.outer(early, forces[depth] - forces[depth + 1])
        if late is not None:
            step[:2] += np.outer(late, forces[depth - 1] - forces[depth])
        return step

    @property
    def _crosses(self) -> bool:
        return self._depth > self._first

    def hull(self) -> Matrix:
        """Matrices whose hull holds those of every two delays."""
        import numpy as np

        first = self._first
        if not self._crosses:
            return np.array([self._matrix(c, None) for c in self._polygon(self._low - first, self._high - first)])
        early, late = self._polygon(0.0, self._high - first - 1.0), self._polygon(self._low - first, 1.0)
        return np.array([self._matrix(a, b) for a in early for b in late])

    def matrix(self, older: float, newer: float) -> Matrix:
        """Matrix of the tick in which the force with the older delay arrives, the next force's delay being `newer`."""
        if not self._crosses:
            return self._matrix(self._share(older - self._first), None)
        late = self._share(newer - self._first) if newer < self._depth else None
        return self._matrix(self._share(max(older - self._depth, 0.0)), late)


def _worst_word(ticks: _Ticks, delay: tuple[float, float], longest: int = 8) -> tuple[float, tuple[float, ...]]:
    """Largest growth per tick of a repeated sequence of delays: of each length only the most promising words go on."""
    import numpy as np

    values = sorted(
        {*np.linspace(*delay, 3).tolist(), *([v] if delay[0] < (v := math.ceil(delay[0])) < delay[1] else [])}
    )
    pairs = np.array([[ticks.matrix(a, b) for b in values] for a in values])
    best, sequence = 0.0, (0,)
    words = [((i,), np.eye(ticks.size)) for i in range(len(values))]
    for length in range(1, longest + 1):
        whole = np.array([pairs[word[-1], word[0]] @ product for word, product in words])
        radii = np.abs(np.linalg.eigvals(whole)).max(axis=1) ** (1.0 / length)
        top = int(np.argmax(radii))
        if radii[top] > best * (1.0 + 1e-12):
            best, sequence = float(radii[top]), words[top][0]
        ranked = np.argsort(-radii)[:60]
        words = [
            ((*words[i][0], j), pairs[words[i][0][-1], j] @ words[i][1]) for i in ranked for j in range(len(values))
        ]
    return best, tuple(values[i] for i in sequence)


def _norm(hull: Matrix) -> Matrix:
    """Seek L with the least largest ‖L M L⁻¹‖: gradients of a soft maximum, from the Lyapunov norm of the mean matrix."""
    import numpy as np
    from scipy.linalg import matrix_balance, solve_discrete_lyapunov
    from scipy.optimize import minimize

    size = hull.shape[1]
    # States differ by orders of magnitude (sections, old forces): balanced first, then where the mean matrix shrinks evenly.
    _, (scales, _) = matrix_balance(np.abs(hull).max(axis=0), permute=False, separate=True)
    mean = hull.mean(axis=0)
    radius = float(np.abs(np.linalg.eigvals(mean)).max())
    slow = mean / (radius + 0.3 * max(1.0 - radius, 1e-4))
    lyapunov = solve_discrete_lyapunov(slow.T, np.diag(scales**-2.0))
    norm = np.asarray(np.linalg.cholesky((lyapunov + lyapunov.T) / 2.0).T, dtype=np.float64)
    lower = np.tril_indices(size)

    def soft(flat: Matrix, sharp: float, family: Matrix) -> tuple[float, Matrix]:
        transform = np.zeros((size, size))
        transform[lower] = flat
        inverse = np.linalg.inv(transform)
        images = transform @ family @ inverse
        u, s, vt = np.linalg.svd(images)
        weights = np.exp(sharp * (s - s.max()))
        total = weights.sum()
        value = float(s.max() + np.log(total) / sharp)
        share = weights / total
        inner = np.einsum("nik,nk,nkj->nij", u, share, vt)
        # d‖·‖ = tr(W' d(L M L⁻¹)), W the weighted sum of u v'.
        gradient = np.einsum("nij,njk->ik", inner, np.transpose(images, (0, 2, 1))) - np.einsum(
            "nji,njk->ik", images, inner
        )
        slope = gradient @ inverse.T
        return value, np.asarray(slope[lower], dtype=np.float64)

    for sharp in (30.0, 100.0, 300.0, 1000.0, 1000.0, 3000.0, 3000.0):
        # In the coordinates of the best norm so far, where all directions weigh the same.
        white = norm @ hull @ np.linalg.inv(norm)
        if np.linalg.norm(white, ord=2, axis=(1, 2)).max() < 1.0 - _ENOUGH:
            break
        found = minimize(
            soft, np.eye(size)[lower], args=(sharp, white), jac=True, method="L-BFGS-B", options={"maxiter": 100}
        )
        change = np.zeros((size, size))
        change[lower] = found.x
        norm = change @ norm
        norm /= np.abs(norm).max()
    return norm


def _close(family: Matrix) -> tuple[int, int, float] | None:
    """Follow all products until their norm is below 1: number of words, longest word, slowest rate; None when too many."""
    import numpy as np

    words, slowest = 0, 0.0
    front = family
    for length in range(1, _DEPTH + 1):
        norms = np.linalg.norm(front, ord=2, axis=(1, 2))
        done = norms < 1.0 - _MARGIN
        words += int(done.sum())
        if done.any():
            slowest = max(slowest, float(norms[done].max()) ** (1.0 / length))
        front = front[~done]
        if not len(front):
            return words, length, slowest
        if len(front) * len(family) > _WORDS:
            return None
        front = np.einsum("nij,mjk->mnik", family, front).reshape(-1, *family.shape[1:])
    return None
