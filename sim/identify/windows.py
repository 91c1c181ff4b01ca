"""Windows of an experiment: searched or held out, and which of them are undisturbed."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.arrays import Array, WholeArray
from sim.identify.experiment import Experiment
from sim.identify.judge_fit import FINEST
from sim.identify.output_error import Fit, fit

HELD_OUT = 4  # one window out of this many is held out to judge the fit
MIN_WINDOWS = 6  # minimum number of undisturbed windows to leave out the others


@dataclass(frozen=True)
class Windows:
    """First ticks of the windows for the search and of the held-out ones, and their length."""

    seen: WholeArray
    unseen: WholeArray
    length: int

    @classmethod
    def of(cls, starts: WholeArray, length: int) -> Windows:
        """Divide windows into searched and held-out ones."""
        unseen = starts[HELD_OUT - 1 :: HELD_OUT]
        return cls(np.setdiff1d(starts, unseen), unseen, length)


def undisturbed(
    experiment: Experiment, found: Fit, scale: float, step: float | None
) -> NDArray[np.bool_]:
    """Return which windows are undisturbed.

    A window is disturbed if its error exceeds four times the median or the rounding; if this
    applies to a third of them, none is. A window with several late answers in a tick, of which only
    the mean is known, is also disturbed if it does not fit a model of the others.
    """

    def fits(errors: Array, middle: float, grid: float) -> NDArray[np.bool_]:
        return np.asarray(
            errors <= (4.0 * max(middle, grid * math.sqrt(found.length / 12.0))) ** 2
        )

    kept = fits(found.errors, math.sqrt(float(np.median(found.errors))), scale)
    if np.mean(kept) <= 2.0 / 3.0:
        kept = np.ones_like(kept)
    late = late_windows(experiment, found)
    whole = kept & ~late
    if not late.any() or np.count_nonzero(whole) < MIN_WINDOWS:
        return kept
    free, length = tuple(found.free.tolist()), found.length
    theta = fit(
        experiment,
        found.starts[whole],
        length,
        found.theta,
        free,
        scale,
        found.states[whole],
    ).theta
    errors = fit(
        experiment, found.starts, length, theta, (), scale, found.states
    ).errors
    return kept & (
        whole | fits(errors, math.sqrt(float(np.median(errors[whole]))), step or FINEST)
    )


def late_windows(experiment: Experiment, found: Fit) -> NDArray[np.bool_]:
    """Return which windows have a late answer."""
    rows = found.starts[:, None] + np.arange(found.length)
    return (
        np.zeros(len(rows), dtype=bool)
        if experiment.late is None
        else experiment.late[rows].any(axis=1)
    )
