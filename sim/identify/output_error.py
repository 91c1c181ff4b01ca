"""Output error: find the device whose exact motion best fits the recorded positions.

The run is cut into windows, each with its own initial state, so nothing before a window needs to be
known and no error propagates into the next. The unknowns are parametrised per unit of mass, where
the motion (`sim.identify.identified_motion`) is nearly linear in them. They are found by
Gauss–Newton steps with Levenberg damping; the initial states are eliminated window by window
(THEORY.md §12).
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.arrays import Array
from sim.identify.experiment import Experiment
from sim.identify.identified_motion import SHARE, STATES, slopes
from sim.measure.cancelling import check

# Smallest value of each unknown, in the order and units of `NAMES`.
LOWER_BOUNDS = np.array(
    [1e-3, 0.0, 0.0, 0.0, -math.inf, 0.0, 0.0, 0.0, 1e-3, 1.0, 0.0, 0.0]
)
# Largest value of each unknown.
UPPER_BOUNDS = np.array(
    [
        1e5,
        math.inf,
        math.inf,
        math.inf,
        math.inf,
        100.0,
        math.inf,
        50.0,
        0.98,
        1000.0,
        2.0,
        0.5,
    ]
)
_DIVERGED = 1e100  # position beyond which a motion has diverged [m]; its square does not overflow
# Finite-difference steps, relative to `_SIZES` or the value, whichever is larger.
_STEPS = np.array(
    [1e-4, 1e-4, 1e-4, 1e-3, 1e-4, 1e-4, 1e-4, 1e-3, 1e-3, 1e-5, 1e-3, 1e-3]
)
_SIZES = np.array([1.0, 1.0, 0.1, 100.0, 1.0, 1.0, 1.0, 1.0, 0.1, 10.0, 0.01, 1.0])


@dataclass
class Fit:
    """Result of the search."""

    theta: Array  # the unknowns, in the order of `NAMES`, shape (12,)
    free: NDArray[np.int64]  # indices of the fitted unknowns
    # initial position [m] and velocity [m/s] of each window, and stretch [m] and its rate [m/s] of
    # a joint, shape (W, 4)
    states: Array
    errors: Array  # sum of squared residuals of each window [m²], shape (W,)
    # normal equations of each window at the solution, initial state eliminated
    matrices: Array
    sides: Array
    starts: NDArray[np.int64]  # first tick of each window, shape (W,)
    length: int  # ticks of a window

    @property
    def rms(self) -> float:
        """Return the root-mean-square residual, corrected for the initial states [m]."""
        samples = len(self.starts) * (self.length - own_states(self.theta))
        return math.sqrt(max(float(self.errors.sum()), 0.0) / samples)


def windows(experiment: Experiment, length: int) -> NDArray[np.int64]:
    """Return the first tick of each window, shape (W,); no window spans a gap."""
    found = [
        start
        for first, end in experiment.segments
        for start in range(first, end - length + 1, length)
    ]
    return np.array(found, dtype=np.int64)


def first_states(
    experiment: Experiment, starts: NDArray[np.int64], length: int
) -> Array:
    """Estimate the initial states (W, 4) of windows from positions; a joint begins at rest."""
    reach = min(8, length - 1)
    x = experiment.position[starts]
    v = (experiment.position[starts + reach] - x) / (reach * experiment.period)
    return np.stack([x, v, np.zeros_like(x), np.zeros_like(x)], axis=1)


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
    """Fit the `free` unknowns until no step lowers the error; `scale` is a small error [m]."""
    check()
    theta = np.array(theta, dtype=np.float64)
    chosen = np.array(free, dtype=np.int64)
    states = (
        first_states(experiment, starts, length) if states is None else states.copy()
    )
    own = own_states(theta)

    def equations(theta: Array, states: Array) -> tuple[Array, ...]:
        return _normal(
            *_slopes(experiment, starts, length, theta, chosen, states, scale),
            own,
            experiment.period,
        )

    now = equations(theta, states)
    damping, stuck = 1e-3, 0
    for _ in range(steps):
        check()
        errors, matrices, sides, alone, along = now
        matrix, side = matrices.sum(axis=0), sides.sum(axis=0)
        move = _step(matrix, side, damping, theta[chosen], LOWER_BOUNDS[chosen])
        there = theta.copy()
        there[chosen] = np.clip(
            theta[chosen] + move, LOWER_BOUNDS[chosen], UPPER_BOUNDS[chosen]
        )
        moved_states = (
            states + alone / (1.0 + damping) - along @ (there[chosen] - theta[chosen])
        )
        new = equations(there, moved_states)
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


def own_states(theta: Array) -> int:
    """Return the number of initial states of a window: 2, or 4 with a joint."""
    return STATES if theta[SHARE] > 0.0 else 2


def left_over(experiment: Experiment, found: Fit, scale: float) -> tuple[Array, Array]:
    """Return the residuals of a fit (W, L) and their derivatives (W, p + s, L)."""
    return _slopes(
        experiment,
        found.starts,
        found.length,
        found.theta,
        found.free,
        found.states,
        scale,
    )


def _slopes(
    experiment: Experiment,
    starts: NDArray[np.int64],
    length: int,
    theta: Array,
    free: NDArray[np.int64],
    states: Array,
    scale: float,
) -> tuple[Array, Array]:
    own, widths = own_states(theta), _STEPS * np.maximum(_SIZES, np.abs(theta))
    residuals, moved = (
        np.empty((len(starts), length)),
        np.empty((len(starts), len(free) + own, length)),
    )
    slopes(
        theta,
        free,
        widths,
        own,
        states,
        np.ascontiguousarray(starts),
        experiment.period,
        experiment.position,
        experiment.missing,
        experiment.at,
        experiment.force,
        scale,
        residuals,
        moved,
    )
    return residuals, moved


def _normal(
    residuals: Array, moved: Array, own: int, period: float
) -> tuple[Array, ...]:
    """Return errors, normal equations without initial states, and the states' own steps.

    Shapes: (W,), (W, p, p), (W, p), then (W, 4) and (W, 4, p).
    """
    windows, length = residuals.shape
    unknowns, initial, error = moved[:, :-own], moved[:, -own:], residuals[:, :, None]
    alone, along = (
        np.zeros((windows, STATES)),
        np.zeros((windows, STATES, unknowns.shape[1])),
    )
    # A diverged motion has no derivatives: a step to it is rejected, a term that starts there is
    # left out.
    if not (np.abs(residuals).max() < _DIVERGED and np.abs(moved).max() < _DIVERGED):
        p = unknowns.shape[1]
        return (
            np.full(windows, np.inf),
            np.zeros((windows, p, p)),
            np.zeros((windows, p)),
            alone,
            along,
        )
    # The states' block is regularised slightly: it is singular while friction holds the device.
    hair = np.where(np.arange(own) % 2 == 0, 1.0, (length * period) ** 2)
    block = initial @ initial.swapaxes(1, 2) + 1e-9 * length * np.diag(hair)
    cross = initial @ unknowns.swapaxes(1, 2)
    alone[:, :own] = np.linalg.solve(block, initial @ error)[:, :, 0]
    along[:, :own] = np.linalg.solve(block, cross)
    sides = (unknowns @ error)[:, :, 0] - (cross.swapaxes(1, 2) @ alone[:, :own, None])[
        :, :, 0
    ]
    matrices = (
        unknowns @ unknowns.swapaxes(1, 2) - cross.swapaxes(1, 2) @ along[:, :own]
    )
    return (residuals**2).sum(axis=1), matrices, sides, alone, along


def _step(matrix: Array, side: Array, damping: float, at: Array, least: Array) -> Array:
    """Return a damped step that does not push unknowns below their minimum."""
    move = np.zeros_like(at)
    inside = np.ones(len(at), dtype=bool)
    size = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    scaled = matrix * np.outer(size, size) + damping * np.eye(len(at))
    for _ in range(len(at)):
        move[:] = 0.0
        block = scaled[np.ix_(inside, inside)]
        move[inside] = (
            size[inside] * np.linalg.lstsq(block, (size * side)[inside], rcond=None)[0]
        )
        outward = inside & (at <= least) & (move < 0.0)
        if not outward.any():
            break
        inside &= ~outward
        if not inside.any():
            return np.zeros_like(at)
    return move
