"""Certificate of stability for every sequence of delays within a range.

A jittering delay can be worse than each of its values, which no pole radius shows. Each tick
multiplies the loop's state by one of a family of matrices; it is stable for every sequence iff the
joint spectral radius of the family is below 1 (THEORY.md §10). The family is enclosed by a few
matrices: within a tick, the force's share of the motion moves along a curve, which lies in the
triangles of a few parabolas except for a remainder that is added to every norm. Gradients search
for an ellipsoidal norm in which every matrix contracts. If one does not, all longer products
starting with it are checked until their norm is below 1. If all products contract, every sequence
of delays is stable, with a known rate. A product that grows is a sequence of delays that makes the
loop unstable.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from nodes.laws import CompiledLaw
from nodes.stability.flexible import FlexiblePlant, Matrix, loop_matrix
from nodes.stability.plant import Plant

# longest state for which a norm is searched; n + 1 taps give n + 3 states and the delay's ticks
MAX_STATES = 40

_SEGMENTS = 2
_WORDS = 60_000
_DEPTH = 60
_MARGIN = 1e-9
_ENOUGH = 1e-6


class Certificate(StrEnum):
    """Answer of a search for a proof of stability; only `CERTIFIED` is true."""

    CERTIFIED = "certified"
    UNSTABLE = "unstable"  # an unstable case was found
    UNDECIDED = "undecided"  # neither a proof nor an unstable case
    TOO_WIDE = "too_wide"  # not searched: the delays are more than a tick apart

    def __bool__(self) -> bool:
        """Return whether there is a proof."""
        return self is Certificate.CERTIFIED


@dataclass(frozen=True)
class EveryDelay:
    """Whether a loop is stable for every sequence of delays."""

    stable: Certificate  # unstable: with a growing sequence
    # factor per tick by which every motion contracts in the certificate's norm; None without one
    rate: float | None
    # products in the certificate: runs of delays over which the norm contracts
    words: int
    longest: int  # ticks of the longest of them
    # delays of a sequence that grows when repeated [ticks]; empty without one
    growing: tuple[float, ...]
    growth: float  # its factor per tick, the largest found, growing or not


def every_delay(
    law: CompiledLaw,
    plant: Plant | FlexiblePlant,
    delay: tuple[float, float],
    rate: float = 1.0,
    period: float | None = None,
) -> EveryDelay:
    """Certify a loop for every sequence of delays of a range, or find an unstable one.

    `delay`: shortest and longest delay, in place of the plant's, at most one tick apart, so that no
    force overtakes another [ticks]. `rate`: factor per tick by which every motion must contract; 1
    requires stability only. `period`: sampling period of a flexible device [s]; a `Plant` has its
    own. Raises ValueError for any other range, for a law that is too long, and for a flexible
    device without a period.
    """
    low, high = delay
    if not 0.0 <= low <= high <= low + 1.0:
        raise ValueError(
            f"delay {low:g}..{high:g} ticks: expected low to high, at most one tick apart"
        )
    ticks = _Ticks(law, *_device(plant, period), delay)
    if ticks.size > MAX_STATES:
        raise ValueError(
            f"law: {ticks.size} states, at most {MAX_STATES} are certified; shorten the law"
        )
    growth, growing = _worst_word(ticks, delay)
    if growth >= rate:
        return EveryDelay(Certificate.UNSTABLE, None, 0, 0, growing, growth)
    hull = ticks.hull() / rate
    norm = _norm(hull)
    balanced = norm @ hull @ np.linalg.inv(norm)
    closed = _close(balanced, ticks.off(norm) / rate)
    if closed is None:
        return EveryDelay(Certificate.UNDECIDED, None, 0, 0, (), growth)
    words, longest, slowest = closed
    return EveryDelay(Certificate.CERTIFIED, rate * slowest, words, longest, (), growth)


def _device(
    plant: Plant | FlexiblePlant, period: float | None
) -> tuple[FlexiblePlant, float]:
    if isinstance(plant, Plant):
        if plant.partner is not None:
            raise ValueError(
                "plant: a pair of bodies on one law is not certified for a delay that varies; leave"
                " the partner out"
            )
        return FlexiblePlant(
            plant.mass, plant.damping, stiffness=plant.stiffness
        ), plant.period
    if period is None:
        raise ValueError(
            "period: a flexible device has none of its own; give the loop's [s]"
        )
    return plant, period


class _Ticks:
    """Matrices of one tick for the delays of two successive forces, and their hull."""

    def __init__(
        self,
        law: CompiledLaw,
        plant: FlexiblePlant,
        period: float,
        delay: tuple[float, float],
    ) -> None:
        self._low, self._high = delay
        self._first = math.floor(delay[0])
        # The pending force of age `depth` arrives in each tick, or may; if the range crosses a
        # whole tick, the next one may arrive late in the same tick.
        self._depth = self._first + 1 if delay[1] > self._first + 1 else self._first
        self._crosses = self._depth > self._first
        # Scaled to lengths, lengths per tick and displacements per force, to balance the matrix.
        self._matrix_of_motion, self._push = plant.continuous()
        self.states = len(self._push)
        units = np.array([1.0, period, 1.0, period][: self.states - (plant.lag > 0.0)])
        units = (
            np.append(units, period * period / plant.mass) if plant.lag > 0.0 else units
        )
        self._matrix_of_motion = (
            period * self._matrix_of_motion * units[:, None] / units
        )
        self._push = self._push * units * plant.mass / period
        base = loop_matrix(law, period, replace(plant, delay=float(self._depth)))
        self.size = len(base)
        every = np.append(units, np.ones(self.size - self.states))
        base = base * every[:, None] / every
        newest = self.size - 1 - self._depth
        self._forces = rows = [base[newest].copy(), *np.eye(self.size)[newest:]]
        base[: self.states] = 0.0
        base[: self.states, : self.states] = self._held(1.0)[0]
        base[: self.states] += np.outer(self._share(0.0), rows[self._depth + 1])
        self._base = base

    def _held(self, ticks: float) -> tuple[Matrix, Matrix]:
        """Return the motion over a part of a tick: free, and per force."""
        from scipy.linalg import expm

        whole = np.zeros((self.states + 1, self.states + 1))
        whole[:-1, :-1], whole[:-1, -1] = self._matrix_of_motion, self._push
        moved = expm(whole * ticks)
        return moved[:-1, :-1], moved[:-1, -1]

    def _share(self, s: float) -> Matrix:
        """Return the motion per force acting from s to the end of a tick, in units of the state."""
        return self._held(max(1.0 - s, 0.0))[1]

    def _polygon(self, low: float, high: float) -> list[Matrix]:
        """Return corners whose hull encloses the curve of shares, except for `_remainder`.

        Each piece contributes its ends and the control point of its parabola.
        """
        if high <= low:
            return [self._share(low)]
        knots = np.linspace(low, high, 2 * _SEGMENTS + 1).tolist()
        shares = [self._share(s) for s in knots]
        corners = [shares[0]]
        for left, middle, right in zip(
            shares[:-1:2], shares[1::2], shares[2::2], strict=True
        ):
            corners += [2.0 * middle - 0.5 * (left + right), right]
        return corners

    def _remainder(self, low: float, high: float) -> Matrix:
        """Return a bound, state by state, of the curve's distance from those parabolas."""
        from scipy.linalg import expm

        if high <= low:
            return np.zeros(self.states)
        # The third derivative with respect to s is −A² e^{A(1−s)} b: sampled, and bounded between
        # samples.
        motion, push = self._matrix_of_motion, self._push
        times = np.linspace(1.0 - high, 1.0 - low, 65).tolist()
        moved = np.array([self._held(t)[0] for t in times])
        half = 0.5 * (times[1] - times[0])
        powers = [np.linalg.matrix_power(motion, n) for n in (2, 3, 4)]
        steepest = np.abs(powers[2]) @ expm(np.abs(motion) * times[-1]) @ np.abs(push)
        for power in (powers[1], powers[0]):
            steepest = np.abs(moved @ push @ power.T).max(axis=0) + half * steepest
        # A parabola through both ends and the middle is off by at most h³/(72√3) times it.
        width = (high - low) / _SEGMENTS
        return np.asarray(
            width**3 / (72.0 * math.sqrt(3.0)) * steepest, dtype=np.float64
        )

    def _matrix(self, early: Matrix, late: Matrix | None) -> Matrix:
        forces, depth = self._forces, self._depth
        step: Matrix = self._base.copy()
        step[: self.states] += np.outer(early, forces[depth] - forces[depth + 1])
        if late is not None:
            step[: self.states] += np.outer(late, forces[depth - 1] - forces[depth])
        return step

    def _parts(self) -> list[tuple[float, float]]:
        """Return when forces may arrive within a tick: one interval, or an early and a late one."""
        low, high = self._low - self._first, self._high - self._first
        return [(0.0, high - 1.0), (low, 1.0)] if self._crosses else [(low, high)]

    def hull(self) -> Matrix:
        """Return matrices whose hull encloses those of every two delays, except for `off`."""
        polygons = [self._polygon(*part) for part in self._parts()]
        if not self._crosses:
            return np.array([self._matrix(corner, None) for corner in polygons[0]])
        return np.array([self._matrix(a, b) for a in polygons[0] for b in polygons[1]])

    def off(self, norm: Matrix) -> float:
        """Return a bound, in a norm, of the distance of any tick's matrix from that hull."""
        inverse, largest = np.linalg.inv(norm), 0.0
        for part, newer in zip(
            self._parts(), (self._depth, self._depth - 1), strict=False
        ):
            change = (self._forces[newer] - self._forces[newer + 1]) @ inverse
            remainder = np.abs(norm[:, : self.states]) @ self._remainder(*part)
            largest += float(np.linalg.norm(remainder)) * float(np.linalg.norm(change))
        return largest

    def matrix(self, older: float, newer: float) -> Matrix:
        """Return the matrix of the tick in which the force with delay `older` arrives.

        `newer` is the delay of the next force.
        """
        if not self._crosses:
            return self._matrix(self._share(older - self._first), None)
        late = self._share(newer - self._first) if newer < self._depth else None
        return self._matrix(self._share(max(older - self._depth, 0.0)), late)


def _worst_word(
    ticks: _Ticks, delay: tuple[float, float], longest: int = 8
) -> tuple[float, tuple[float, ...]]:
    """Return the largest growth per tick of a repeated sequence of delays, and the sequence.

    It is a beam search: of each length, only the fastest-growing sequences are extended.
    """
    values = sorted(
        {
            *np.linspace(*delay, 3).tolist(),
            *([v] if delay[0] < (v := math.ceil(delay[0])) < delay[1] else []),
        }
    )
    pairs = np.array([[ticks.matrix(a, b) for b in values] for a in values])
    best, sequence = 0.0, (0,)
    words = [((i,), np.eye(ticks.size)) for i in range(len(values))]
    for length in range(1, longest + 1):
        whole = np.array(
            [pairs[word[-1], word[0]] @ product for word, product in words]
        )
        radii = np.abs(np.linalg.eigvals(whole)).max(axis=1) ** (1.0 / length)
        top = int(np.argmax(radii))
        if radii[top] > best * (1.0 + 1e-12):
            best, sequence = float(radii[top]), words[top][0]
        ranked = np.argsort(-radii)[:60]
        words = [
            ((*words[i][0], j), pairs[words[i][0][-1], j] @ words[i][1])
            for i in ranked
            for j in range(len(values))
        ]
    return best, tuple(values[i] for i in sequence)


def _norm(hull: Matrix) -> Matrix:
    """Return L with a small maximum of ‖L M L⁻¹‖ over the family.

    It follows gradients of a soft maximum, from the Lyapunov norm of the mean matrix.
    """
    from scipy.linalg import matrix_balance, solve_discrete_lyapunov
    from scipy.optimize import minimize

    size = hull.shape[1]
    # States differ by orders of magnitude (sections, old forces): balance first, then start where
    # the mean matrix contracts evenly.
    _, (scales, _) = matrix_balance(
        np.abs(hull).max(axis=0), permute=False, separate=True
    )
    mean = hull.mean(axis=0)
    radius = float(np.abs(np.linalg.eigvals(mean)).max())
    slow = mean / (radius + 0.3 * max(1.0 - radius, 1e-4))
    lyapunov = solve_discrete_lyapunov(slow.T, np.diag(scales**-2.0))
    norm = np.asarray(
        np.linalg.cholesky((lyapunov + lyapunov.T) / 2.0).T, dtype=np.float64
    )
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
        inner = np.einsum("nik,nk,nkj->nij", u, weights / total, vt)
        # d‖·‖ = tr(W' d(L M L⁻¹)), W the weighted sum of u v'.
        gradient = np.einsum(
            "nij,njk->ik", inner, np.transpose(images, (0, 2, 1))
        ) - np.einsum("nji,njk->ik", images, inner)
        return value, np.asarray((gradient @ inverse.T)[lower], dtype=np.float64)

    for sharp in (30.0, 100.0, 300.0, 1000.0, 1000.0, 3000.0, 3000.0):
        # in the coordinates of the best norm so far, where all directions weigh the same
        white = norm @ hull @ np.linalg.inv(norm)
        if np.linalg.norm(white, ord=2, axis=(1, 2)).max() < 1.0 - _ENOUGH:
            break
        found = minimize(
            soft,
            np.eye(size)[lower],
            args=(sharp, white),
            jac=True,
            method="L-BFGS-B",
            options={"maxiter": 100},
        )
        change = np.zeros((size, size))
        change[lower] = found.x
        norm = change @ norm
        norm /= np.abs(norm).max()
    return norm


def _close(family: Matrix, off: float) -> tuple[int, int, float] | None:
    """Extend products, each with error `off`, until their norm is below 1.

    Return the number of products, the longest and the slowest rate; None if there are too many.
    """
    words, slowest = 0, 0.0
    single = np.linalg.norm(family, ord=2, axis=(1, 2))
    front, doubt = family, np.full(len(family), off)
    for length in range(1, _DEPTH + 1):
        norms = np.linalg.norm(front, ord=2, axis=(1, 2)) + doubt
        done = norms < 1.0 - _MARGIN
        words += int(done.sum())
        if done.any():
            slowest = max(slowest, float(norms[done].max()) ** (1.0 / length))
        front, doubt, norms = front[~done], doubt[~done], norms[~done]
        if not len(front):
            return words, length, slowest
        if len(front) * len(family) > _WORDS:
            return None
        front = np.einsum("nij,mjk->mnik", family, front).reshape(-1, *family.shape[1:])
        # ‖(M + E)(P + D)‖ differs from ‖MP‖ by ‖M‖‖D‖ + ‖E‖‖P + D‖; the norms include D already.
        doubt = (doubt[:, None] * single + off * norms[:, None]).ravel()
    return None
