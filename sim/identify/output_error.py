"""Output error: the device whose exact motion under the recorded forces comes closest to the recorded positions.

The run is cut into windows, each with an initial state of its own, so that nothing has to be known
before a window and no error grows from one into the next. The unknowns are taken where the motion
(`sim.identify.identified_motion`) is nearly linear in them, per unit of mass. Gauss–Newton steps
with Levenberg's damping find them all; the initial states are eliminated window by window.
THEORY.md §12.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.arrays import Array
from sim.identify.experiment import Experiment
from sim.identify.identified_motion import SHARE, STATES, slopes

# Smallest value of each unknown, in the order and the units of `NAMES`.
LEAST = np.array([1e-3, 0.0, 0.0, 0.0, -math.inf, 0.0, 0.0, 0.0, 1e-3, 1.0, 0.0, 0.0])
# Largest value of each.
MOST = np.array(
    [1e5, math.inf, math.inf, math.inf, math.inf, 100.0, math.inf, 50.0, 0.98, 1000.0, 2.0, 0.5]
)
_DIVERGED = 1e100  # of a position [m]: its square can still be added up
# Differences that slopes are taken over, as a part of `_SIZES` or of the value, whichever is
# larger.
_STEPS = np.array([1e-4, 1e-4, 1e-4, 1e-3, 1e-4, 1e-4, 1e-4, 1e-3, 1e-3, 1e-5, 1e-3, 1e-3])
_SIZES = np.array([1.0, 1.0, 0.1, 100.0, 1.0, 1.0, 1.0, 1.0, 0.1, 10.0, 0.01, 1.0])


@dataclass
class Fit:
    """What the search came to."""

    theta: Array  # the unknowns, in the order of `NAMES`, shape (12,)
    free: NDArray[np.int64]  # which of them were looked for
    # Initial position [m] and velocity [m/s] of each window, and stretch [m] and its rate [m/s] of
    # a joint, shape (W, 4).
    states: Array
    errors: Array  # sum of squared residuals of each window [m²], shape (W,)
    # Normal equations of each window at the end, the initial state eliminated.
    matrices: Array
    sides: Array
    starts: NDArray[np.int64]  # first tick of each window, shape (W,)
    length: int  # ticks of a window

    @property
    def rms(self) -> float:
        """Root-mean-square residual, the windows' own degrees of freedom taken off [m]."""
        samples = len(self.starts) * (self.length - own_states(self.theta))
        return math.sqrt(max(float(self.errors.sum()), 0.0) / samples)


def windows(experiment: Experiment, length: int) -> NDArray[np.int64]:
    """Cut an experiment into windows: first tick of each, shape (W,); none spans a gap."""
    found = [
        start
        for first, end in experiment.segments
        for start in range(first, end - length + 1, length)
    ]
    return np.array(found, dtype=np.int64)


def first_states(experiment: Experiment, starts: NDArray[np.int64], length: int) -> Array:
    """Guess the states (W, 4) at the beginning of windows from the positions after it; a joint begins at rest."""
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
    """Find the `free` unknowns from a first guess of all until no step lowers the error; `scale` is a small error [m]."""
    theta = np.array(theta, dtype=np.float64)
    chosen = np.array(free, dtype=np.int64)
    states = first_states(experiment, starts, length) if states is None else states.copy()
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
        errors, matrices, sides, alone, along = now
        matrix, side = matrices.sum(axis=0), sides.sum(axis=0)
        move = _step(matrix, side, damping, theta[chosen], LEAST[chosen])
        there = theta.copy()
        there[chosen] = np.clip(theta[chosen] + move, LEAST[chosen], MOST[chosen])
        moved_states = states + alone / (1.0 + damping) - along @ (there[chosen] - theta[chosen])
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
    """Count the states that each window has of its own: 2, or 4 with a joint."""
    return STATES if theta[SHARE] > 0.0 else 2


def left_over(experiment: Experiment, found: Fit, scale: float) -> tuple[Array, Array]:
    """Give what a fit leaves (W, L), and what each unknown and each window's own state moves (W, p + s, L)."""
    return _slopes(
        experiment, found.starts, found.length, found.theta, found.free, found.states, scale
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
        theta, free, widths, own, states, np.ascontiguousarray(starts), experiment.period,
        experiment.position, experiment.missing, experiment.at, experiment.force, scale, residuals,
        moved,
    )  # fmt: skip
    return residuals, moved


def _normal(residuals: Array, moved: Array, own: int, period: float) -> tuple[Array, ...]:
    """Errors (W,), normal equations (W, p, p), (W, p) freed of initial states, and what moves those: (W, 4), (W, 4, p)."""
    windows, length = residuals.shape
    unknowns, initial, error = moved[:, :-own], moved[:, -own:], residuals[:, :, None]
    alone, along = np.zeros((windows, STATES)), np.zeros((windows, STATES, unknowns.shape[1]))
    # What diverges has no slopes: a step that leads there is taken back, a term that begins there
    # is left out.
    if not (np.abs(residuals).max() < _DIVERGED and np.abs(moved).max() < _DIVERGED):
        p = unknowns.shape[1]
        return (
            np.full(windows, np.inf),
            np.zeros((windows, p, p)),
            np.zeros((windows, p)),
            alone,
            along,
        )
    # The states' own block, a hair away from singular where friction holds the device all the time.
    hair = np.where(np.arange(own) % 2 == 0, 1.0, (length * period) ** 2)
    block = initial @ initial.swapaxes(1, 2) + 1e-9 * length * np.diag(hair)
    cross = initial @ unknowns.swapaxes(1, 2)
    alone[:, :own] = np.linalg.solve(block, initial @ error)[:, :, 0]
    along[:, :own] = np.linalg.solve(block, cross)
    sides = (unknowns @ error)[:, :, 0] - (cross.swapaxes(1, 2) @ alone[:, :own, None])[:, :, 0]
    matrices = unknowns @ unknowns.swapaxes(1, 2) - cross.swapaxes(1, 2) @ along[:, :own]
    return (residuals**2).sum(axis=1), matrices, sides, alone, along


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
