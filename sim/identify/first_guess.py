"""A first guess for the search, from linear equations: no starting point, so no wrong valley to begin in.

Multiply the equation of motion by a smooth bump φ that vanishes with its slope at both ends, and integrate by parts: no
position is differentiated, only φ is. What is left is linear in all unknowns but the delay, which is tried out. Encoder
rounding biases the result by some percent, which is why it is a first guess only.
"""

from __future__ import annotations

import numpy as np

from sim.arrays import Array
from sim.identify.experiment import Experiment

HALF_WIDTH = 24
"""Half the length of the bump [ticks]."""
DELAYS = np.arange(0.0, 12.01, 0.5)
"""Delays that are tried [ticks]."""


def first_guess(experiment: Experiment, held: bool) -> Array:
    """Solve the linear equations at every delay and take the one that fits best."""
    period = experiment.period
    s = np.linspace(-1.0, 1.0, 2 * HALF_WIDTH + 1)
    unit = HALF_WIDTH * period
    bump = (1.0 - s**2) ** 4
    slope = -8.0 * s * (1.0 - s**2) ** 3 / unit
    bend = (-8.0 * (1.0 - s**2) ** 3 + 48.0 * s**2 * (1.0 - s**2) ** 2) / unit**2
    # ∫ force dt at the forces' own instants is piecewise linear, and so exact at any delay.
    impulse = np.concatenate([[0.0], np.cumsum(experiment.force[:-1] * np.diff(experiment.at))])
    best: tuple[float, Array] = (np.inf, np.array([10.0, 5.0, 0.3, 0.0, 0.0, 0.0, *[0.0] * 5]))
    parts = [part for part in experiment.segments if part[1] - part[0] > 3 * HALF_WIDTH]

    def over(signal: Array, kernel: Array) -> Array:
        return np.asarray(np.convolve(signal, kernel[::-1], "valid")[::5] * period)

    def all_parts(signal: Array, kernel: Array) -> Array:
        return np.concatenate([over(signal[first:end], kernel) for first, end in parts])

    x = experiment.position
    smooth = np.convolve(x, np.ones(9) / 9.0, "same")
    direction = np.sign(np.gradient(smooth))
    columns = [all_parts(x, slope), -all_parts(direction, bump), all_parts(np.ones_like(x), bump)]
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
            best = error, np.array([max(g, 0.1), max(b, 0.0), max(c, 0.0), max(k, 0.0), load, delay, *[0.0] * 5])
    return best[1]
