"""Deepest minima of a function: where they are, how many, and what is skipped."""

from __future__ import annotations

import numpy as np
import pytest

from nodes.stability.dips import dips
from sim.arrays import Array

GRID = np.linspace(0.0, np.pi, 201)
SPACING = np.pi / 200


def corners(places: list[float], depths: list[float], at: Array) -> Array:
    """Return the least of cones whose tips lie at some places; infinite depths leave none."""
    cones = [np.abs(at - p) - d for p, d in zip(places, depths, strict=True)]
    return np.asarray(np.min(cones, axis=0))


def test_a_corner_is_found_to_the_last_zoom() -> None:
    """Eight zooms into two of sixteen cells leave cells of 8⁻⁸ of the grid's spacing."""
    places = [0.1234567, 0.777, 1.5010101, 2.2, 3.0123]
    depths = [0.1, 0.3, 0.2, 0.5, 0.4]
    found, value = dips(
        lambda at: corners(places, depths, at), GRID, corners(places, depths, GRID)
    )
    assert list(found) == pytest.approx(
        [2.2, 3.0123, 0.777, 1.5010101, 0.1234567], abs=0.5 * SPACING * 8.0**-8 + 1e-15
    )
    assert list(value) == pytest.approx(
        sorted(-d for d in depths), abs=0.5 * SPACING * 8.0**-8 + 1e-15
    )


def test_the_eight_deepest_are_returned_and_the_ends_count() -> None:
    places = [0.0, *np.linspace(0.3, 2.8, 8).tolist(), np.pi]
    depths = [0.02, *np.linspace(0.03, 0.1, 8).tolist(), 0.2]
    found, _ = dips(
        lambda at: corners(places, depths, at), GRID, corners(places, depths, GRID)
    )
    assert list(found) == pytest.approx([np.pi, *places[8:1:-1]], abs=1e-9)


def test_what_is_not_finite_is_no_dip() -> None:
    """NaN and infinity are skipped; without a finite value there is no dip."""

    def broken(at: Array) -> Array:
        return np.where(at < 1.0, np.nan, np.where(at > 2.0, np.inf, at))

    found, value = dips(broken, GRID, broken(GRID))
    assert list(found) == pytest.approx([1.0], abs=SPACING * 8.0**-8)
    assert list(value) == list(found)
    for nothing in (np.nan, np.inf):
        found, value = dips(broken, GRID, np.full(201, nothing))
        assert found.size == value.size == 0
