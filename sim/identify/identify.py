"""Identify a device: parameters with 95 % intervals, or the reasons why not.

The first guess solves linear equations, so it has no local minima. The equation of motion is
multiplied by a bump φ that vanishes with its slope at both ends, and integrated by parts, so only φ
is differentiated. The result is linear in all unknowns but the delay, which is tried on a grid.
Encoder rounding biases it by some percent.
"""

import math

import numpy as np
from numpy.typing import NDArray

from sim.arrays import Array
from sim.identify.choose_model import choose
from sim.identify.conclude import conclude, covariance_of, nothing
from sim.identify.experiment import Experiment, encoder
from sim.identify.identified import Identified
from sim.identify.identified_motion import (
    AVERAGE,
    DAMPING,
    DELAY,
    FRICTION,
    LAG,
    LOAD,
    MOBILITY,
    NAMES,
    STIFFNESS,
    window,
)
from sim.identify.output_error import Fit, fit, windows
from sim.identify.windows import Windows

WINDOW = 100  # length of a window [ticks]


def identify(
    experiment: Experiment, held: bool | None = None, length: int = WINDOW
) -> Identified:
    """Identify a device from at least 12 windows.

    held: whether a hand holds the device; None: decide from the data.
    length: ticks of a window.

    Raise ValueError if there are fewer than 12 windows.
    """
    starts = windows(experiment, length)
    if len(starts) < 12:
        raise ValueError(
            f"{len(starts)} windows of {length} ticks, at least 12 are needed: record {12 * length}"
            " ticks without gaps"
        )
    if not np.ptp(experiment.force) > 0.0:
        return nothing(
            experiment,
            length,
            "the force never changed, so the device cannot be identified; push it (haptic "
            "launch identify)",
        )
    within = np.zeros(len(experiment.position), dtype=bool)
    for first, end in experiment.segments:
        within[first:end] = True
    grid = encoder(experiment.position[within & ~experiment.missing])
    scale = grid.value or 1e-6
    cut = Windows.of(starts, length)
    found = _search(experiment, cut.seen, length, scale, held)
    return conclude(experiment, choose(experiment, found, cut, scale, grid.value), grid)


def initial_state(experiment: Experiment, found: Identified) -> tuple[float, float]:
    """Return the initial position [m] and velocity [m/s] of an identified device."""
    first = _begun(experiment, found, np.zeros(1, dtype=np.int64))
    return float(first.states[0, 0]), float(first.states[0, 1])


def followed(
    experiment: Experiment, found: Identified, count: int
) -> tuple[NDArray[np.int64], Array]:
    """Simulate the first windows of a run, each from its recorded initial state.

    Return the first ticks and the positions [m].
    """
    starts = windows(experiment, found.ticks)[:count]
    begun = _begun(experiment, found, starts)
    positions = np.empty((len(starts), found.ticks))
    for start, state, out in zip(starts.tolist(), begun.states, positions, strict=True):
        window(
            begun.theta,
            state,
            start,
            found.ticks,
            experiment.period,
            experiment.at,
            experiment.force,
            out,
        )
    return starts, positions


def _begun(experiment: Experiment, found: Identified, starts: NDArray[np.int64]) -> Fit:
    """Fit the initial state of each window for a known device."""
    mass, _, _ = found.mass.known()
    theta = np.zeros(len(NAMES))
    theta[MOBILITY] = 1.0 / mass
    for name in ("damping", "friction", "stiffness", "load", "quadratic"):
        theta[NAMES.index(name)] = (getattr(found, name).value or 0.0) / mass
    for name in ("share", "frequency", "loss"):
        theta[NAMES.index(name)] = getattr(found, name).value or 0.0
    theta[AVERAGE] = found.average.value or 0.0
    # The mean delay of an averaging sensor is included in the device's own delay.
    theta[DELAY] = max((found.device_delay.value or 0.0) - theta[AVERAGE], 0.0)
    theta[LAG] = (found.lag.value or 0.0) / experiment.period
    return fit(experiment, starts, found.ticks, theta, (), found.encoder.value or 1e-6)


def _search(
    experiment: Experiment,
    starts: NDArray[np.int64],
    length: int,
    scale: float,
    held: bool | None,
) -> Fit:
    """Fit all unknowns, starting at the guess of the linear equations."""
    free = (
        (MOBILITY, DAMPING, FRICTION, LOAD)
        if held is False
        else (MOBILITY, DAMPING, FRICTION, STIFFNESS, LOAD)
    )
    full: Fit | None = None
    for stiff in (True, False)[held is False :]:
        # Without a hand the equations of a free device are more precise; the closer start is used.
        here = fit(
            experiment,
            starts,
            length,
            first_guess(experiment, stiff),
            free,
            scale,
            steps=5,
        )
        here = fit(
            experiment, starts, length, here.theta, (*free, DELAY), scale, here.states
        )
        if full is None or here.rms < full.rms:
            full = here
        if full.rms < 0.5 * scale:
            break
    assert full is not None  # noqa: S101
    if held is None and not _is_held(full):
        theta = full.theta.copy()
        theta[STIFFNESS] = 0.0
        full = fit(
            experiment,
            starts,
            length,
            theta,
            (MOBILITY, DAMPING, FRICTION, LOAD, DELAY),
            scale,
            full.states,
        )
    return full


def _is_held(found: Fit) -> bool:
    """Check that the hand's stiffness exceeds four of its standard deviations."""
    at = list(found.free).index(STIFFNESS)
    covariance = covariance_of(found)
    return float(found.theta[STIFFNESS]) > 4.0 * math.sqrt(covariance[at, at])


HALF_WIDTH = 24  # half length of the bump [ticks]
DELAYS = np.arange(0.0, 12.01, 0.5)  # delays tried [ticks]


def first_guess(experiment: Experiment, held: bool) -> Array:
    """Solve the linear equations at every delay and return the best fit."""
    period = experiment.period
    s = np.linspace(-1.0, 1.0, 2 * HALF_WIDTH + 1)
    unit = HALF_WIDTH * period
    bump = (1.0 - s**2) ** 4
    slope = -8.0 * s * (1.0 - s**2) ** 3 / unit
    bend = (-8.0 * (1.0 - s**2) ** 3 + 48.0 * s**2 * (1.0 - s**2) ** 2) / unit**2
    # The integral of the force over its recorded instants is piecewise linear, so it is exact at
    # any delay.
    impulse = np.concatenate(
        [[0.0], np.cumsum(experiment.force[:-1] * np.diff(experiment.at))]
    )
    best: tuple[float, Array] = (
        np.inf,
        np.array([10.0, 5.0, 0.3, 0.0, 0.0, 0.0, *[0.0] * 6]),
    )
    parts = [part for part in experiment.segments if part[1] - part[0] > 3 * HALF_WIDTH]

    def over(signal: Array, kernel: Array) -> Array:
        return np.asarray(np.convolve(signal, kernel[::-1], "valid")[::5] * period)

    def all_parts(signal: Array, kernel: Array) -> Array:
        return np.concatenate([over(signal[first:end], kernel) for first, end in parts])

    x = experiment.position
    direction = np.sign(np.gradient(np.convolve(x, np.ones(9) / 9.0, "same")))
    columns = [
        all_parts(x, slope),
        -all_parts(direction, bump),
        all_parts(np.ones_like(x), bump),
    ]
    if held:
        columns.append(-all_parts(x, bump))
    target = all_parts(x, bend)
    ticks = np.arange(len(x), dtype=np.float64)
    for delay in DELAYS.tolist():
        then = ticks - delay
        pushed = np.interp(then, experiment.at, impulse)
        late = then > experiment.at[-1]
        pushed[late] += experiment.force[-1] * (then[late] - experiment.at[-1])
        matrix = np.stack([-all_parts(pushed * period, slope), *columns], axis=1)
        size = np.maximum(np.linalg.norm(matrix, axis=0), 1e-300)
        solution = np.linalg.lstsq(matrix / size, target, rcond=None)[0] / size
        error = float(np.linalg.norm(matrix @ solution - target))
        if error < best[0]:
            g, b, c, load, k = (*solution.tolist(), 0.0)[:5]
            best = (
                error,
                np.array(
                    [
                        max(g, 0.1),
                        max(b, 0.0),
                        max(c, 0.0),
                        max(k, 0.0),
                        load,
                        delay,
                        *[0.0] * 6,
                    ]
                ),
            )
    return best[1]
