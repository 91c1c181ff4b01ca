"""Judge a fit by what it leaves: whether that is no more than rounding and white noise, and which term the data ask for if not.

Rounding is not white where the device is slow. So what a model that holds would leave is drawn: its
own motion, rounded on grids that lie anywhere, with as much white noise before as the residual asks
for (THEORY.md §12).
"""

import math
from dataclasses import dataclass

import numpy as np

from sim.arrays import Array
from sim.identify.experiment import Experiment
from sim.identify.output_error import Fit, left_over, own_states
from sim.identify.suspects import Shapes, Suspect

DRAWS = 40  # how often a model that holds is drawn
# grid of an encoder whose own is not seen; what is left below its rounding is arithmetic [m]
FINEST = 1e-9
LAGS = 20  # of the autocorrelation [ticks]
SURE = 5.0  # so many standard deviations are no chance, among some hundred suspects
QUANTILE = 1.96  # of a 95 % interval [standard deviations]
IMPROBABLE = 1e-4  # whiteness below which a model does not hold


@dataclass(frozen=True)
class Left:
    """What a fit leaves in its windows, freed of all that its unknowns and the windows' own states could still take up."""

    residual: Array  # of the positions [m], shape (W, L)
    draws: Array  # the same of models that hold, shape (B, W, L)
    # Root mean square of the residual, and what rounding alone leaves [m].
    size: float
    rounding: float
    modelled: Array  # positions of the model [m], shape (W, L)
    # Orthonormal bases of what those move.
    states: Array
    unknowns: Array
    slopes: Array  # what each unknown moves, freed of the windows' own states, shape (p, W L)


def _freed(what: Array, states: Array, unknowns: Array) -> Array:
    """Free shapes (..., W, L) of what states and unknowns take up."""
    what = what - np.einsum("wks,...ws->...wk", states, np.einsum("wks,...wk->...ws", states, what))
    if unknowns.size:
        flat = what.reshape(*what.shape[:-2], -1)
        flat = flat - (flat @ unknowns) @ unknowns.T
        what = flat.reshape(what.shape)
    return np.asarray(what, dtype=np.float64)


def left(experiment: Experiment, found: Fit, step: float | None, seed: int = 1) -> Left:
    """Take apart what a fit leaves."""
    residual, moved = left_over(experiment, found, step or 1e-6)
    p, own = len(found.free), own_states(found.theta)
    rows = found.starts[:, None] + np.arange(found.length)
    unread = experiment.missing[rows]
    modelled = experiment.position[rows] - residual
    # An orthonormal basis of what each window's own state moves, then one of what the unknowns move
    # besides.
    columns = np.swapaxes(moved[:, p:], 1, 2)
    columns = columns / np.maximum(np.linalg.norm(columns, axis=1, keepdims=True), 1e-300)
    u, s, _ = np.linalg.svd(columns, full_matrices=False)
    states = u * (s > 1e-9 * s[:, :1])[:, None, :]
    unknowns = np.zeros((residual.size, 0))
    raw = _freed(np.moveaxis(moved[:, :p], 1, 0), states, unknowns).reshape(p, residual.size)
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

    # Rounding alone first: what the residual is more than that is white noise in a model that
    # holds.
    draws = drawn(0.0)
    rounding = float(np.mean(np.sum(draws**2, axis=(1, 2)))) / samples
    noise = math.sqrt(max(size**2 - rounding, 0.0))
    if noise > 0.1 * size:
        draws = drawn(noise)
    return Left(clean, draws, size, math.sqrt(rounding), modelled, states, unknowns, raw)


def whiteness(what: Left) -> float:
    """Tell how probable it is that a model that holds leaves residuals at least so far from white."""
    from scipy.stats import gamma

    # What fits to the bit (windows at rest) leaves nothing that could have a colour.
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
    # How far models that hold are from their own mean: the lags are not independent where rounding
    # is slow.
    own = np.mean(((drawn - middle) / spread) ** 2, axis=1) * (DRAWS + 1) / (DRAWS - 1)
    shape = float(own.mean() ** 2 / own.var(ddof=1))
    return float(
        gamma.sf(
            float(np.mean(((seen - middle) / spread) ** 2)), shape, scale=float(own.mean()) / shape
        )
    )


def unsteady(experiment: Experiment, what: Left) -> tuple[float, float]:
    """Tell the spread of the samples' instants [s], by what is left where it is fast, and how sure that is [deviations]."""
    squared = np.gradient(what.modelled, experiment.period, axis=1) ** 2
    around = squared - squared.mean()
    slope = np.sum(what.residual**2 * around) / np.sum(around**2)
    drawn = np.sum(what.draws**2 * around, axis=(1, 2)) / np.sum(around**2)
    spread = max(float(drawn.std(ddof=1)), 1e-300)
    over = float(slope - drawn.mean())
    return math.sqrt(max(over, 0.0)), over / spread


@dataclass(frozen=True)
class Evidence:
    """How much of the residual one suspect takes up."""

    suspect: Suspect  # the term
    strength: float  # of its best factor, in standard deviations of the same in models that hold
    share: float  # part that it takes up of what the residual has beyond rounding
    factor: float  # of its first shape
    visible: float  # factor that would have `SURE` standard deviations
    factors: Array  # of each shape, fitted together, shape (g,)
    # By how much more of itself the term may be, at 95 %, by how the windows differ about it.
    margin: float
    # what the unknowns of the fit would change by if the term were added, in the order of
    # `Fit.free`
    moves: Array


def scan(experiment: Experiment, found: Fit, what: Left) -> list[Evidence]:
    """Try every suspect on what is left, that which takes up most first."""
    findings = []
    beyond = (
        max(1.0 - (what.rounding / what.size) ** 2, 1.0 / what.residual.size) if what.size else 1.0
    )
    power = float(np.sum(what.residual**2)) * beyond
    for suspect in Shapes(experiment, found, what.modelled).all():
        shapes = _freed(suspect.shapes, what.states, what.unknowns).reshape(len(suspect.shapes), -1)
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
        factors = np.linalg.lstsq((shapes / norms[:, None]).T, residual, rcond=None)[0] / norms
        explained = factors @ shapes
        strength, share = (
            seen / spread / math.sqrt(q.shape[1]),
            min(seen**2 / power, 1.0) if power > 0.0 else 0.0,
        )
        carried = _carried(what, suspect, factors, explained)
        visible = SURE * spread / float(norms[0])
        findings.append(Evidence(suspect, strength, share, factor, visible, factors, *carried))
    return sorted(findings, key=lambda one: -one.share)


def _carried(what: Left, suspect: Suspect, factors: Array, explained: Array) -> tuple[float, Array]:
    """Return how much more of itself a term may be, and what it would move the unknowns of the fit by."""
    size = float(np.linalg.norm(explained))
    windows = len(what.residual)
    if size == 0.0:
        return 0.0, np.zeros(len(what.slopes))
    unit = (explained / size).reshape(windows, -1)
    # Each window's own vote: what is left besides, of whatever colour, makes them differ.
    votes = np.sum(what.residual * unit, axis=1) - np.sum(unit**2, axis=1) * size
    margin = QUANTILE * math.sqrt(float(np.sum(votes**2)) * windows / max(windows - 1, 1)) / size
    whole = _freed(np.tensordot(factors, suspect.shapes, 1), what.states, what.unknowns[:, :0])
    moves = (
        np.linalg.lstsq(what.slopes.T, whole.ravel(), rcond=None)[0]
        if len(what.slopes)
        else np.zeros(0)
    )
    return margin, -np.asarray(moves, dtype=np.float64)
