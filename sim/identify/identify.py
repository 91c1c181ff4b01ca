"""Identify a device from an experiment: each parameter with a 95 % interval, or with the reason why it cannot be told."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sim.arrays import Array
from sim.identify.choose_model import Windows, choose
from sim.identify.conclude import conclude, covariance_of, nothing
from sim.identify.encoder import encoder
from sim.identify.experiment import Experiment
from sim.identify.first_guess import first_guess
from sim.identify.identified import Identified
from sim.identify.identified_motion import (
    DAMPING,
    DELAY,
    FREQUENCY,
    FRICTION,
    LAG,
    LOAD,
    LOSS,
    MOBILITY,
    NAMES,
    QUADRATIC,
    SHARE,
    STIFFNESS,
    window,
)
from sim.identify.output_error import Fit, fit, windows

WINDOW = 100
"""Ticks of a window."""
HELD_OUT = 4
"""Every so many windows one is held out, to judge the fit by what it has not seen."""


def identify(experiment: Experiment, held: bool | None = None, length: int = WINDOW) -> Identified:
    """Identify a device.

    `experiment`: the run: at least 12 windows. `held`: whether a hand holds the device; None finds out. Raises ValueError when
    the run is too short.
    """
    starts = windows(experiment, length)
    if len(starts) < 12:
        raise ValueError(
            f"{len(starts)} windows of {length} ticks, at least 12 are needed: record {12 * length} ticks without gaps"
        )
    if not np.ptp(experiment.force) > 0.0:
        return nothing(
            experiment, length, "the force never changed: nothing tells the device; push it (haptic launch identify)"
        )
    within = np.zeros(len(experiment.position), dtype=bool)
    for first, end in experiment.segments:
        within[first:end] = True
    grid = encoder(experiment.position[within & ~experiment.missing])
    scale = grid.step or 1e-6
    unseen = starts[HELD_OUT - 1 :: HELD_OUT]
    seen = np.setdiff1d(starts, unseen)
    found = _search(experiment, seen, length, scale, held)
    return conclude(experiment, choose(experiment, found, Windows(seen, unseen, length), scale, grid.step), grid)


def initial_state(experiment: Experiment, found: Identified) -> tuple[float, float]:
    """Find where an identified device begins, from its first window.

    `experiment`: a run from its first tick on. Returns, shape (2,): position [m] and velocity [m/s] at the first tick.
    """
    first = _begun(experiment, found, np.zeros(1, dtype=np.int64))
    return float(first.states[0, 0]), float(first.states[0, 1])


def followed(experiment: Experiment, found: Identified, count: int) -> tuple[NDArray[np.int64], Array]:
    """Let an identified device move through the first windows of a run, each from where the run has it at its beginning.

    `found`: the device, its mass known; with its joint, lag and quadratic damping, where it has any. Returns `starts` (first
    tick of each window), `positions` (of the model [m]).
    """
    starts = windows(experiment, found.ticks)[:count]
    begun = _begun(experiment, found, starts)
    positions = np.empty((len(starts), found.ticks))
    for start, state, out in zip(starts.tolist(), begun.states, positions, strict=True):
        window(begun.theta, state, start, found.ticks, experiment.period, experiment.at, experiment.force, out)
    return starts, positions


def _begun(experiment: Experiment, found: Identified, starts: NDArray[np.int64]) -> Fit:
    """Find where a device that is known begins each window, with all that was found of it."""
    mass, _, _ = found.mass.known()
    per_mass = {DAMPING: found.damping, FRICTION: found.friction, STIFFNESS: found.stiffness, LOAD: found.load}
    per_mass[QUADRATIC] = found.quadratic
    direct = {DELAY: found.device_delay, SHARE: found.share, FREQUENCY: found.frequency, LOSS: found.loss}
    theta = np.zeros(len(NAMES))
    theta[MOBILITY] = 1.0 / mass
    for which, part in per_mass.items():
        theta[which] = (part.value or 0.0) / mass
    for which, part in direct.items():
        theta[which] = part.value or 0.0
    theta[LAG] = (found.lag.value or 0.0) / experiment.period
    return fit(experiment, starts, found.ticks, theta, (), found.encoder.value or 1e-6)


def _search(experiment: Experiment, starts: NDArray[np.int64], length: int, scale: float, held: bool | None) -> Fit:
    """From the linear equations' guess to everything."""
    free = (MOBILITY, DAMPING, FRICTION, LOAD) if held is False else (MOBILITY, DAMPING, FRICTION, STIFFNESS, LOAD)
    full: Fit | None = None
    for stiff in (True, False)[held is False :]:
        # The equations of a free device tell more when there is no hand; which of the two starts nearer decides.
        guess = first_guess(experiment, stiff)
        here = fit(experiment, starts, length, guess, free, scale, steps=5)
        here = fit(experiment, starts, length, here.theta, (*free, DELAY), scale, here.states)
        if full is None or here.rms < full.rms:
            full = here
        if full.rms < 0.5 * scale:
            break
    assert full is not None  # noqa: S101
    if held is None and not _is_held(full):
        theta = full.theta.copy()
        theta[STIFFNESS] = 0.0
        full = fit(experiment, starts, length, theta, (MOBILITY, DAMPING, FRICTION, LOAD, DELAY), scale, full.states)
    return full


def _is_held(found: Fit) -> bool:
    """Whether the stiffness of a hand stands out of its own error, and out of what it could be mistaken for."""
    at = list(found.free).index(STIFFNESS)
    covariance = covariance_of(found)
    k = float(found.theta[STIFFNESS])
    return k > 4.0 * math.sqrt(covariance[at, at])
