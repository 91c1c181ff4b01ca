"""Judge a fit by its residual: only rounding and white noise, or a missing term.

Rounding is not white if the device is slow. So the residual of a valid model is simulated: its own
motion, rounded on grids with random offsets, plus as much white noise as the residual requires
(THEORY.md §12).
"""

import math
from dataclasses import dataclass

import numpy as np

from sim.arrays import Array
from sim.identify.experiment import Experiment
from sim.identify.output_error import Fit, left_over, own_states
from sim.identify.suspects import Shapes, Suspect

DRAWS = 40  # simulated residuals of a valid model
# assumed grid of an encoder without a visible step; a residual below its rounding is numerical
# error [m]
FINEST = 1e-9
LAGS = 20  # lags of the autocorrelation [ticks]
# significance threshold among about a hundred suspects [standard deviations]
SURE = 5.0
QUANTILE = 1.96  # half-width of a 95 % interval [standard deviations]
IMPROBABLE = 1e-4  # whiteness below which a model is refuted


@dataclass(frozen=True)
class Left:
    """Residual after projecting out parameters and initial states."""

    residual: Array  # of the positions [m], shape (W, L)
    draws: Array  # the same for simulated valid models, shape (B, W, L)
    # root-mean-square of the residual, and the part due to rounding [m]
    size: float
    rounding: float
    modelled: Array  # positions of the model [m], shape (W, L)
    # orthonormal bases of the effects of initial states and unknowns
    states: Array
    unknowns: Array
    slopes: Array  # effect of each unknown after projecting out the initial states, shape (p, W L)


def _freed(what: Array, states: Array, unknowns: Array) -> Array:
    """Project out the effects of states and unknowns from shapes (..., W, L)."""
    what = what - np.einsum(
        "wks,...ws->...wk", states, np.einsum("wks,...wk->...ws", states, what)
    )
    if unknowns.size:
        flat = what.reshape(*what.shape[:-2], -1)
        flat = flat - (flat @ unknowns) @ unknowns.T
        what = flat.reshape(what.shape)
    return np.asarray(what, dtype=np.float64)


def left(experiment: Experiment, found: Fit, step: float | None, seed: int = 1) -> Left:
    """Decompose the residual of a fit."""
    residual, moved = left_over(experiment, found, step or 1e-6)
    p, own = len(found.free), own_states(found.theta)
    rows = found.starts[:, None] + np.arange(found.length)
    unread = experiment.missing[rows]
    modelled = experiment.position[rows] - residual
    # An orthonormal basis of the effects of each window's initial state, then one of the remaining
    # effects of the unknowns.
    columns = np.swapaxes(moved[:, p:], 1, 2)
    columns = columns / np.maximum(
        np.linalg.norm(columns, axis=1, keepdims=True), 1e-300
    )
    u, s, _ = np.linalg.svd(columns, full_matrices=False)
    states = u * (s > 1e-9 * s[:, :1])[:, None, :]
    unknowns = np.zeros((residual.size, 0))
    raw = _freed(np.moveaxis(moved[:, :p], 1, 0), states, unknowns).reshape(
        p, residual.size
    )
    if p:
        along = raw / np.maximum(np.linalg.norm(raw, axis=1, keepdims=True), 1e-300)
        u, s, _ = np.linalg.svd(along.T, full_matrices=False)
        unknowns = u[:, s > 1e-9 * s[0]]
    clean = _freed(residual, states, unknowns)
    samples = max(int((~unread).sum()) - own * len(residual) - unknowns.shape[1], 1)
    size = math.sqrt(float(np.sum(clean**2)) / samples)
    if step is None and size <= FINEST / math.sqrt(12.0):
        clean, size = np.zeros_like(clean), 0.0
    rng = np.random.default_rng(seed)
    grid = step or FINEST
    true = modelled + rng.uniform(0.0, grid, (DRAWS, 1, 1))

    def drawn(noise: float) -> Array:
        read = true + noise * rng.standard_normal(true.shape) if noise else true
        error = np.round(read / grid) * grid - true
        error[:, unread] = 0.0
        return _freed(error, states, unknowns)

    # Rounding alone first; the rest of the residual counts as white noise of a valid model.
    draws = drawn(0.0)
    rounding = float(np.mean(np.sum(draws**2, axis=(1, 2)))) / samples
    noise = math.sqrt(max(size**2 - rounding, 0.0))
    if noise > 0.1 * size:
        draws = drawn(noise)
    return Left(
        clean, draws, size, math.sqrt(rounding), modelled, states, unknowns, raw
    )


def whiteness(what: Left) -> float:
    """Return the probability that a valid model leaves residuals at least as far from white."""
    from scipy.special import gammaincc  # scipy.stats takes 0.5 s to load

    # An exact fit (windows at rest) has no residual to be correlated.
    if not np.any(what.residual):
        return 1.0

    def correlation(rows: Array) -> Array:
        power = np.sum(rows**2, axis=(-2, -1))
        lags = [
            np.sum(rows[..., lag:] * rows[..., :-lag], axis=(-2, -1)) / power
            for lag in range(1, LAGS + 1)
        ]
        return np.stack(lags, axis=-1)

    drawn, seen = correlation(what.draws), correlation(what.residual)
    middle, spread = drawn.mean(axis=0), drawn.std(axis=0, ddof=1)
    # Distance of valid models from their own mean: the lags are not independent if rounding errors
    # vary slowly.
    own = np.mean(((drawn - middle) / spread) ** 2, axis=1) * (DRAWS + 1) / (DRAWS - 1)
    shape = float(own.mean() ** 2 / own.var(ddof=1))
    return float(
        gammaincc(
            shape,
            float(np.mean(((seen - middle) / spread) ** 2))
            / (float(own.mean()) / shape),
        )
    )


def unsteady(experiment: Experiment, what: Left) -> tuple[float, float]:
    """Estimate the jitter of the sample instants [s] and its significance [deviations].

    Jitter makes the residual grow with the speed.
    """
    squared = np.gradient(what.modelled, experiment.period, axis=1) ** 2
    around = squared - squared.mean()
    slope = np.sum(what.residual**2 * around) / np.sum(around**2)
    drawn = np.sum(what.draws**2 * around, axis=(1, 2)) / np.sum(around**2)
    spread = max(float(drawn.std(ddof=1)), 1e-300)
    over = float(slope - drawn.mean())
    return math.sqrt(max(over, 0.0)), over / spread


@dataclass(frozen=True)
class Evidence:
    """How much of the residual one suspect explains."""

    suspect: Suspect  # the term
    strength: float  # of its best factor, in standard deviations for valid models
    share: float  # explained share of the residual beyond rounding
    factor: float  # factor of its first shape
    visible: float  # factor with a significance of `SURE`
    factors: Array  # factors of all shapes, fitted together, shape (g,)
    # relative uncertainty of the term at 95 %, from the spread between windows
    margin: float
    # change of each unknown of the fit if the term were added, in the order of `Fit.free`
    moves: Array


def scan(experiment: Experiment, found: Fit, what: Left) -> list[Evidence]:
    """Fit every suspect to the residual; return them sorted by explained share."""
    findings = []
    beyond = (
        max(1.0 - (what.rounding / what.size) ** 2, 1.0 / what.residual.size)
        if what.size
        else 1.0
    )
    power = float(np.sum(what.residual**2)) * beyond
    for suspect in Shapes(experiment, found, what.modelled).all():
        shapes = _freed(suspect.shapes, what.states, what.unknowns).reshape(
            len(suspect.shapes), -1
        )
        norms = np.linalg.norm(shapes, axis=1)
        raw = np.linalg.norm(suspect.shapes.reshape(len(shapes), -1), axis=1)
        if not np.all(norms > 1e-6 * raw) or not np.all(np.isfinite(norms)):
            continue
        q, _ = np.linalg.qr((shapes / norms[:, None]).T)
        seen = float(np.linalg.norm(what.residual.ravel() @ q))
        drawn = np.linalg.norm(what.draws.reshape(DRAWS, -1) @ q, axis=1)
        spread = math.sqrt(float(np.mean(drawn**2)) / q.shape[1])
        factor = float(what.residual.ravel() @ shapes[0]) / float(norms[0]) ** 2
        residual = what.residual.ravel()
        factors = (
            np.linalg.lstsq((shapes / norms[:, None]).T, residual, rcond=None)[0]
            / norms
        )
        explained = factors @ shapes
        strength, share = (
            seen / spread / math.sqrt(q.shape[1]),
            min(seen**2 / power, 1.0) if power > 0.0 else 0.0,
        )
        carried = _carried(what, suspect, factors, explained)
        visible = SURE * spread / float(norms[0])
        findings.append(
            Evidence(suspect, strength, share, factor, visible, factors, *carried)
        )
    return sorted(findings, key=lambda one: -one.share)


def _carried(
    what: Left, suspect: Suspect, factors: Array, explained: Array
) -> tuple[float, Array]:
    """Return the relative uncertainty of a term and its effect on the unknowns of the fit."""
    size = float(np.linalg.norm(explained))
    windows = len(what.residual)
    if size == 0.0:
        return 0.0, np.zeros(len(what.slopes))
    unit = (explained / size).reshape(windows, -1)
    # One estimate per window: the remaining residual, whatever its spectrum, makes them differ.
    votes = np.sum(what.residual * unit, axis=1) - np.sum(unit**2, axis=1) * size
    margin = (
        QUANTILE
        * math.sqrt(float(np.sum(votes**2)) * windows / max(windows - 1, 1))
        / size
    )
    whole = _freed(
        np.tensordot(factors, suspect.shapes, 1), what.states, what.unknowns[:, :0]
    )
    moves = (
        np.linalg.lstsq(what.slopes.T, whole.ravel(), rcond=None)[0]
        if len(what.slopes)
        else np.zeros(0)
    )
    return margin, -np.asarray(moves, dtype=np.float64)
