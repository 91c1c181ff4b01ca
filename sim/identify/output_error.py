"""Output error: the device whose exact motion under the recorded forces comes closest to the recorded positions.

The run is cut into windows, each with an initial state of its own, so that nothing has to be known before a window and no
error grows from one into the next. Within a window the device moves by the exact map with Coulomb friction
(`sim.device.friction`), from one force to the next wherever in the tick that one takes effect. The unknowns are taken where the
motion is nearly linear in them, per unit of mass: 1/m, b/m, c/m, k/m, constant load/m, and the device's own delay. Gauss–Newton
steps with Levenberg's damping find them all; the initial states are eliminated window by window. THEORY.md §12.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.device.friction import slide
from sim.device.model import coefficients
from sim.identify.experiment import Experiment
from sim.scene.compiled import compiled

__all__ = [
    "DAMPING",
    "DELAY",
    "FRICTION",
    "LEAST",
    "LOAD",
    "MOBILITY",
    "MOST",
    "NAMES",
    "STIFFNESS",
    "Array",
    "Fit",
    "first_states",
    "fit",
    "windows",
]

Array = NDArray[np.float64]

MOBILITY, DAMPING, FRICTION, STIFFNESS, LOAD, DELAY = range(6)
NAMES = ("mobility", "damping", "friction", "stiffness", "load", "delay")
LEAST = np.array([1e-3, 0.0, 0.0, 0.0, -math.inf, 0.0])
"""Smallest value of each unknown: 1/m [1/kg], b/m [1/s], c/m [m/s²], k/m [1/s²], load/m [m/s²], delay [ticks]."""
MOST = np.array([1e5, math.inf, math.inf, math.inf, math.inf, 100.0])
"""Largest value of each."""
_STEPS = np.array([1e-4, 1e-4, 1e-4, 1e-3, 1e-4, 1e-4])
"""Differences that slopes are taken over, as a part of `_SIZES` or of the value, whichever is larger."""
_SIZES = np.array([1.0, 1.0, 0.1, 100.0, 1.0, 1.0])


@compiled()
def _window(
    theta: Array,
    x: float,
    v: float,
    start: int,
    length: int,
    period: float,
    at: Array,
    force: Array,
    out: Array,
) -> None:
    """Positions of one window from its initial state."""
    mobility, damping, friction, stiffness, load, delay = theta[0], theta[1], theta[2], theta[3], theta[4], theta[5]
    # The force that acts when the window begins: the last one that took effect until then.
    j = np.searchsorted(at, start - delay, "right") - 1
    acting = force[j] if j >= 0 else 0.0
    known = period
    coefs = coefficients(1.0, damping, stiffness, known)
    for k in range(length):
        out[k] = x
        now = 0.0
        while j + 1 < len(at) and at[j + 1] + delay < start + k + 1:
            until = at[j + 1] + delay - (start + k)
            if until > now:
                duration = (until - now) * period
                if abs(duration - known) > 1e-12 * period:
                    coefs = coefficients(1.0, damping, stiffness, duration)
                    known = duration
                x, v = slide(x, v, mobility * acting + load, duration, coefs, 1.0, damping, stiffness, friction)
                now = until
            j += 1
            acting = force[j]
        duration = (1.0 - now) * period
        if duration > 1e-12 * period:
            if abs(duration - known) > 1e-12 * period:
                coefs = coefficients(1.0, damping, stiffness, duration)
                known = duration
            x, v = slide(x, v, mobility * acting + load, duration, coefs, 1.0, damping, stiffness, friction)


@compiled()
def _normal(
    theta: Array,
    free: NDArray[np.int64],
    steps: Array,
    states: Array,
    starts: NDArray[np.int64],
    length: int,
    period: float,
    position: Array,
    missing: NDArray[np.bool_],
    at: Array,
    force: Array,
    scale: float,
) -> tuple[Array, Array, Array, Array, Array]:
    """Squared error of each window, and its normal equations with the initial state eliminated.

    Returns errors (W,), matrices (W, p, p), right sides (W, p), and what moves each state: (W, 2) and (W, 2, p).
    """
    windows, p = len(starts), len(free)
    errors = np.zeros(windows)
    matrices = np.zeros((windows, p, p))
    sides = np.zeros((windows, p))
    alone = np.zeros((windows, 2))
    along = np.zeros((windows, 2, p))
    here = np.empty(length)
    there = np.empty(length)
    slopes = np.empty((p + 2, length))
    for w in range(windows):
        start, x, v = starts[w], states[w, 0], states[w, 1]
        _window(theta, x, v, start, length, period, at, force, here)
        residual = position[start : start + length] - here
        unread = missing[start : start + length]
        residual[unread] = 0.0
        errors[w] = residual @ residual
        for i in range(p):
            moved = theta.copy()
            moved[free[i]] += steps[free[i]]
            _window(moved, x, v, start, length, period, at, force, there)
            slopes[i] = (there - here) / steps[free[i]]
        _window(theta, x + 0.01 * scale, v, start, length, period, at, force, there)
        slopes[p] = (there - here) / (0.01 * scale)
        nudge = 0.1 * scale / (length * period)
        _window(theta, x, v + nudge, start, length, period, at, force, there)
        slopes[p + 1] = (there - here) / nudge
        slopes[:, unread] = 0.0
        # The state's own 2 × 2 block, a hair away from singular where friction holds the device all the time.
        a = slopes[p] @ slopes[p]
        d = slopes[p + 1] @ slopes[p + 1]
        b = slopes[p] @ slopes[p + 1]
        a += 1e-9 * length
        d += 1e-9 * length * (length * period) ** 2
        determinant = a * d - b * b
        own_x = slopes[p] @ residual
        own_v = slopes[p + 1] @ residual
        alone[w, 0] = (d * own_x - b * own_v) / determinant
        alone[w, 1] = (a * own_v - b * own_x) / determinant
        for i in range(p):
            with_x = slopes[i] @ slopes[p]
            with_v = slopes[i] @ slopes[p + 1]
            along[w, 0, i] = (d * with_x - b * with_v) / determinant
            along[w, 1, i] = (a * with_v - b * with_x) / determinant
        for i in range(p):
            with_x = slopes[i] @ slopes[p]
            with_v = slopes[i] @ slopes[p + 1]
            sides[w, i] = slopes[i] @ residual - with_x * alone[w, 0] - with_v * alone[w, 1]
            for k in range(p):
                matrices[w, i, k] = slopes[i] @ slopes[k] - with_x * along[w, 0, k] - with_v * along[w, 1, k]
    return errors, matrices, sides, alone, along


@dataclass
class Fit:
    """What the search came to.

    Attributes
    ----------
    theta : ndarray, shape (6,)
        The unknowns, in the order of `NAMES`.
    free : ndarray of int
        Which of them were looked for.
    states : ndarray, shape (W, 2)
        Initial position [m] and velocity [m/s] of each window.
    errors : ndarray, shape (W,)
        Sum of squared residuals of each window [m²].
    matrices, sides : ndarray, shapes (W, p, p) and (W, p)
        Normal equations of each window at the end, the initial state eliminated.
    starts : ndarray of int, shape (W,)
        First tick of each window.
    length : int
        Ticks of a window.
    """

    theta: Array
    free: NDArray[np.int64]
    states: Array
    errors: Array
    matrices: Array
    sides: Array
    starts: NDArray[np.int64]
    length: int

    @property
    def rms(self) -> float:
        """Root-mean-square residual, two degrees of freedom per window taken off [m]."""
        samples = len(self.starts) * (self.length - 2)
        return math.sqrt(max(float(self.errors.sum()), 0.0) / samples)


def windows(experiment: Experiment, length: int) -> NDArray[np.int64]:
    """Cut an experiment into windows.

    Parameters
    ----------
    experiment : Experiment
        The run.
    length : int
        Ticks of a window.

    Returns
    -------
    ndarray of int, shape (W,)
        First tick of each; none spans a gap.
    """
    found = [start for first, end in experiment.segments for start in range(first, end - length + 1, length)]
    return np.array(found, dtype=np.int64)


def first_states(experiment: Experiment, starts: NDArray[np.int64], length: int) -> Array:
    """Guess the state at the beginning of each window from the positions after it.

    Parameters
    ----------
    experiment : Experiment
        The run.
    starts : ndarray of int, shape (W,)
        First ticks.
    length : int
        Ticks of a window.

    Returns
    -------
    ndarray, shape (W, 2)
        Position [m] and velocity [m/s].
    """
    reach = min(8, length - 1)
    x = experiment.position[starts]
    v = (experiment.position[starts + reach] - x) / (reach * experiment.period)
    return np.stack([x, v], axis=1)


def fit(
    experiment: Experiment,
    starts: NDArray[np.int64],
    length: int,
    theta: Array,
    free: tuple[int, ...],
    scale: float,
    states: Array | None = None,
    steps: int = 60,
) -> Fit:
    """Find the unknowns from a first guess.

    Parameters
    ----------
    experiment : Experiment
        The run.
    starts : ndarray of int, shape (W,)
        First tick of each window.
    length : int
        Ticks of a window.
    theta : ndarray, shape (6,)
        First guess, in the order of `NAMES`.
    free : tuple of int
        Which of them are looked for; the others stay.
    scale : float
        Size of a small error of position: an encoder step [m].
    states : ndarray, shape (W, 2), optional
        First guess of the initial states.
    steps : int
        Most steps.

    Returns
    -------
    Fit
        Where no step lowers the error any more.
    """
    theta = np.array(theta, dtype=np.float64)
    chosen = np.array(free, dtype=np.int64)
    states = first_states(experiment, starts, length) if states is None else states.copy()

    def normal(theta: Array, states: Array) -> Any:
        widths = _STEPS * np.maximum(_SIZES, np.abs(theta))
        return _normal(
            theta, chosen, widths, states, starts, length, experiment.period, experiment.position, experiment.missing,
            experiment.at, experiment.force, scale,
        )  # fmt: skip

    now = normal(theta, states)
    damping, stuck = 1e-3, 0
    for _ in range(steps):
        errors, matrices, sides, alone, along = now
        matrix, side = matrices.sum(axis=0), sides.sum(axis=0)
        move = _step(matrix, side, damping, theta[chosen], LEAST[chosen])
        there = theta.copy()
        there[chosen] = np.clip(theta[chosen] + move, LEAST[chosen], MOST[chosen])
        moved = there[chosen] - theta[chosen]
        moved_states = states + alone / (1.0 + damping) - along @ moved
        new = normal(there, moved_states)
        before, after = float(errors.sum()), float(new[0].sum())
        if math.isfinite(after) and after <= before:
            theta, states, now = there, moved_states, new
            damping = max(0.2 * damping, 1e-9)
            stuck = stuck + 1 if before - after <= 1e-9 * before else 0
            if stuck >= 3:
                break
        else:
            damping = max(damping * 8.0, 1e-6)
            if damping > 1e8:
                break
    errors, matrices, sides, _, _ = now
    return Fit(theta, chosen, states, errors, matrices, sides, starts, length)


def _step(matrix: Array, side: Array, damping: float, at: Array, least: Array) -> Array:
    """One damped step that leaves alone what would be pushed below its least value."""
    move = np.zeros_like(at)
    inside = np.ones(len(at), dtype=bool)
    size = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    scaled = matrix * np.outer(size, size) + damping * np.eye(len(at))
    for _ in range(len(at)):
        move[:] = 0.0
        block = scaled[np.ix_(inside, inside)]
        move[inside] = size[inside] * np.linalg.lstsq(block, (size * side)[inside], rcond=None)[0]
        outward = inside & (at <= least) & (move < 0.0)
        if not outward.any():
            break
        inside &= ~outward
        if not inside.any():
            return np.zeros_like(at)
    return move
