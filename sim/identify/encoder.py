"""The encoder's step, read off the positions: all of them lie on one grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim.arrays import Array

LEAST_VALUES = 8
"""Fewer different positions could lie on many grids."""
STRAY = 0.02
"""How far from the grid a position may be, as a part of the step: rounding, not motion."""


@dataclass(frozen=True)
class Encoder:
    """What positions tell of the encoder."""

    step: float | None  # distance of neighbouring readings [m]; None when it cannot be told
    error: float = 0.0  # half width of the interval that holds it [m]
    why: str = ""  # why it cannot be told; empty when it can


def encoder(position: Array) -> Encoder:
    """Find the grid that all positions lie on."""
    values = np.unique(position)
    if len(values) < LEAST_VALUES:
        return Encoder(
            None, why=f"only {len(values)} different positions, at least {LEAST_VALUES} are needed: move it more"
        )
    gaps = np.diff(values)
    # Values closer than a millionth of the usual distance are one, rounded differently.
    gaps = gaps[gaps > 1e-6 * float(np.median(gaps))]
    counts = np.round(gaps / gaps.min())
    step = float(np.sum(gaps) / np.sum(counts))
    counts = np.round((values - values[0]) / step)
    slope, offset = np.polyfit(counts, values, 1)
    stray = float(np.max(np.abs(values - offset - slope * counts)))
    if not stray < STRAY * slope:
        return Encoder(
            None, why="the positions lie on no even grid: the encoder is fine, or its axes are not those of the message"
        )
    # Rounding moves each reading by at most `stray`, so the two ends of the grid leave this much room.
    span = float(counts[-1] - counts[0])
    return Encoder(float(slope), 2.0 * (stray + float(np.spacing(np.abs(values).max()))) / span)
