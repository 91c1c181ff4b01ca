"""Identify a device from an experiment: each parameter with a 95 % interval, or with the reason why it cannot be told."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sim.identify.encoder import Encoder, encoder
from sim.identify.experiment import Experiment
from sim.identify.first_guess import first_guess
from sim.identify.identified import Estimate, HeldOut, Identified
from sim.identify.motion import DAMPING, DELAY, FRICTION, LOAD, MOBILITY, STIFFNESS
from sim.identify.output_error import Fit, fit, windows

__all__ = [
    "CONFIDENCE",
    "HELD_OUT",
    "WINDOW",
    "Array",
    "identify",
    "initial_state",
]

Array = NDArray[np.float64]

WINDOW = 100
"""Ticks of a window."""
HELD_OUT = 4
"""Every so many windows one is held out, to judge the fit by what it has not seen."""
CONFIDENCE = 0.95


def identify(experiment: Experiment, held: bool | None = None, length: int = WINDOW) -> Identified:
    """Identify a device.

    Parameters
    ----------
    experiment : Experiment
        The run: at least 12 windows.
    held : bool or None
        Whether a hand holds the device; None finds out.
    length : int
        Ticks of a window.

    Returns
    -------
    Identified
        What the run tells.

    Raises
    ------
    ValueError
        When the run is too short.
    """
    starts = windows(experiment, length)
    if len(starts) < 12:
        raise ValueError(
            f"{len(starts)} windows of {length} ticks, at least 12 are needed: record {12 * length} ticks without gaps"
        )
    if not np.ptp(experiment.force) > 0.0:
        return _nothing(
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
    theta = found.theta.copy()
    test = fit(experiment, unseen, length, theta, (), scale)
    # All windows together for what is reported: the held-out ones have judged.
    states = np.concatenate([found.states, test.states])[np.argsort(np.concatenate([seen, unseen]))]
    free = tuple(found.free.tolist())
    final = fit(experiment, starts, length, theta, free, scale, states)
    kept = _undisturbed(final, scale)
    if not kept.all():
        final = fit(experiment, starts[kept], length, final.theta, free, scale, final.states[kept])
    return _conclude(experiment, final, grid, test, int(np.sum(~kept)))


def initial_state(experiment: Experiment, found: Identified) -> tuple[float, float]:
    """Find where an identified device begins, from its first window.

    Parameters
    ----------
    experiment : Experiment
        A run from its first tick on.
    found : Identified
        The device, its mass known.

    Returns
    -------
    tuple of float, shape (2,)
        Position [m] and velocity [m/s] at the first tick.
    """
    mass, _, _ = found.mass.known()
    parts = (found.damping, found.friction, found.stiffness, found.load)
    theta = np.zeros(11)
    theta[:6] = np.array([1.0, *(part.value or 0.0 for part in parts), mass * (found.device_delay.value or 0.0)]) / mass
    first = fit(experiment, np.zeros(1, dtype=np.int64), found.ticks, theta, (), found.encoder.value or 1e-6)
    return float(first.states[0, 0]), float(first.states[0, 1])


def _undisturbed(found: Fit, scale: float) -> NDArray[np.bool_]:
    """Tell which windows to keep: a stall of the machine or a knock spoils some of them altogether.

    Rounding alone never makes a window four times as bad as the middle one, or as rounding itself where most of them are at
    rest. When more than a third are, it is the model that does not fit, and all of them stay.
    """
    errors = np.sqrt(found.errors)
    kept = np.asarray(errors <= 4.0 * max(float(np.median(errors)), scale * math.sqrt(found.length / 12.0)))
    return kept if np.mean(kept) > 2.0 / 3.0 else np.ones_like(kept)


def _nothing(experiment: Experiment, length: int, why: str) -> Identified:
    """Tell what a run without a changing force tells: its delays and its encoder."""
    unknown = Estimate(None, why=why)
    _, shortest, longest, jitter = _delays(experiment)
    return Identified(
        mass=unknown,
        damping=unknown,
        friction=unknown,
        delay=unknown,
        device_delay=unknown,
        encoder=_step(encoder(experiment.position[~experiment.missing])),
        stiffness=unknown,
        load=unknown,
        jitter=jitter,
        delay_range=(shortest, longest),
        held=False,
        residual=math.nan,
        held_out=HeldOut(),
        dropped=0,
        windows=0,
        ticks=length,
        axis=experiment.axis,
        period=experiment.period,
    )


def _step(grid: Encoder) -> Estimate:
    if grid.step is None:
        return Estimate(None, why=grid.why)
    return Estimate(grid.step, grid.step - grid.error, grid.step + grid.error)


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
    covariance = _covariance(found)
    k = float(found.theta[STIFFNESS])
    return k > 4.0 * math.sqrt(covariance[at, at])


def _covariance(found: Fit) -> Array:
    """Covariance of the unknowns, from how much the windows differ: rounding leaves errors that are not white."""
    matrix = found.matrices.sum(axis=0)
    size = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-60))
    values, vectors = np.linalg.eigh(matrix * np.outer(size, size))
    # A direction without any information gets an error without bound, not a division by zero.
    inverse = (vectors / np.maximum(values, 1e-14)) @ vectors.T * np.outer(size, size)
    windows, p = len(found.starts), len(found.free)
    # Each window's score without its own pull on the estimate (the jackknife's correction, to first order).
    scores = np.empty((windows, p))
    identity = np.eye(p)
    for w in range(windows):
        leverage = found.matrices[w] @ inverse
        scores[w] = np.linalg.lstsq(identity - leverage, found.sides[w], rcond=None)[0]
    between = inverse @ (scores.T @ scores) @ inverse * (windows - 1) / windows
    white = inverse * max(found.rms, 1e-12) ** 2
    # Neither may promise more than the other: take the larger variance of each unknown.
    wider = np.sqrt(np.maximum(np.diag(white) / np.maximum(np.diag(between), 1e-12 * np.diag(white)), 1.0))
    return np.asarray(between * np.outer(wider, wider), dtype=np.float64)


def _conclude(experiment: Experiment, found: Fit, grid: Encoder, test: Fit, dropped: int) -> Identified:
    from scipy.stats import t

    covariance = _covariance(found)
    quantile = float(t.ppf(0.5 + 0.5 * CONFIDENCE, max(1, len(found.starts) - len(found.free))))
    index = {int(which): i for i, which in enumerate(found.free)}
    g = float(found.theta[MOBILITY])
    force = float(np.std(experiment.force)) if len(experiment.force) else 0.0

    def per_mass(which: int) -> tuple[float, float]:
        """Value and half width of an unknown times mass."""
        value = float(found.theta[which]) / g
        slope = np.zeros(len(found.free))
        slope[index[which]] = 1.0 / g
        slope[index[MOBILITY]] -= value / g
        return value, quantile * math.sqrt(max(float(slope @ covariance @ slope), 0.0))

    relative = quantile * math.sqrt(covariance[0, 0]) / g
    speeds = np.diff(experiment.position) / experiment.period
    speed = float(np.sqrt(np.mean(speeds**2)))
    if relative > 0.5 or force == 0.0:
        why = "no force was given: nothing tells the mass" if force == 0.0 else (
            f"its error would be {100 * relative:.0f} %: push with forces that change more, or record longer"
        )  # fmt: skip
        mass = Estimate(None, why=why)
        damping = friction = stiffness = load = Estimate(None, why=f"the mass is not known ({why})")
    else:
        # An interval of 1/m is one of m, and not symmetric.
        mass = Estimate(1.0 / g, 1.0 / (g * (1.0 + relative)), 1.0 / (g * (1.0 - relative)))
        damping = _bounded(*per_mass(DAMPING), max(float(found.theta[DAMPING]) / g, force / speed if speed else 0.0))
        friction = _bounded(*per_mass(FRICTION), 0.5 * force)
        load_value, load_width = per_mass(LOAD)
        load = Estimate(load_value, load_value - load_width, load_value + load_width)
        stiffness = Estimate(0.0, 0.0, 0.0)
        if STIFFNESS in index:
            stiffness = _bounded(*per_mass(STIFFNESS), math.inf)
    late = float(found.theta[DELAY])
    late_width = quantile * math.sqrt(covariance[index[DELAY], index[DELAY]])
    if late_width > 0.5 or force == 0.0:
        why = f"its error would be {late_width:.2g} ticks: the force must change often, by much more than friction"
        own = Estimate(None, why="no force was given" if force == 0.0 else why)
    else:
        own = Estimate(late, max(late - late_width, 0.0), late + late_width)
    median, shortest, longest, jitter = _delays(experiment)
    if own.value is None:
        total = own
    else:
        _, low, high = own.known()
        total = Estimate(own.value + median, low + median, high + median)
        shortest, longest = shortest + low, longest + high
    return Identified(
        mass=mass,
        damping=damping,
        friction=friction,
        delay=total,
        device_delay=own,
        encoder=_step(grid),
        stiffness=stiffness,
        load=load,
        jitter=jitter,
        delay_range=(shortest, longest),
        held=STIFFNESS in index and float(found.theta[STIFFNESS]) > 0.0,
        residual=found.rms,
        # The middle one: a window that a stall spoilt says nothing about the model.
        held_out=HeldOut(math.sqrt(float(np.median(test.errors)) / (test.length - 2))),
        dropped=dropped,
        windows=len(found.starts),
        ticks=found.length,
        axis=experiment.axis,
        period=experiment.period,
    )


def _bounded(value: float, width: float, too_wide: float) -> Estimate:
    """Estimate what cannot be negative; None when its error is as large as what it is told from."""
    if width > too_wide:
        return Estimate(None, why=f"its error would be {width:.2g}, as large as what it is told from ({too_wide:.2g})")
    return Estimate(value, max(value - width, 0.0), value + width)


def _delays(experiment: Experiment) -> tuple[float, float, float, Estimate]:
    """Median, shortest and longest delay of the loop, and its jitter with an interval from halves of the run."""
    delay = experiment.delay
    if len(delay) < 100:
        return 0.0, 0.0, 0.0, Estimate(None, why=f"{len(delay)} ticks were answered in time, at least 100 are needed")
    median = float(np.median(delay))
    shortest, longest = (float(q) for q in np.quantile(delay, (0.001, 0.999)))
    blocks = np.array_split(delay, 10)
    rng = np.random.default_rng(1)
    spreads = []
    for _ in range(200):
        again = np.concatenate([blocks[i] for i in rng.integers(0, len(blocks), len(blocks))])
        low, high = np.quantile(again, (0.001, 0.999))
        spreads.append(high - low)
    low, high = (float(q) for q in np.quantile(spreads, (0.025, 0.975)))
    value = longest - shortest
    return median, shortest, longest, Estimate(value, min(low, value), max(high, value))
