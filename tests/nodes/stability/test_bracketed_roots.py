"""Roots between brackets against closed forms, all at once."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nodes.stability.bracketed_roots import roots_between
from sim.arrays import Array

EPS = float(np.finfo(np.float64).eps)


def test_roots_are_found_to_the_rounding_of_their_position() -> None:
    """Zeros of the cosine, rising and falling, in brackets of any width."""
    low = np.array([0.0, 1.5, 3.0, 7.0, 7.85])
    high = np.array([3.0, 1.6, 6.0, 8.0, 9.0])
    found = roots_between(np.cos, low, high)
    wanted = np.array([0.5, 0.5, 1.5, 2.5, 2.5]) * math.pi
    assert np.abs(found - wanted).max() <= 4.0 * EPS * wanted.max()


def test_an_end_that_is_a_root_is_returned() -> None:
    def parabola(at: Array) -> Array:
        return np.asarray(at * at - 1.0)

    found = roots_between(
        parabola, np.array([1.0, 0.0, -1.0]), np.array([3.0, 1.0, 0.5])
    )
    assert list(found) == [1.0, 1.0, -1.0]
    assert roots_between(parabola, np.empty(0), np.empty(0)).size == 0


@given(st.floats(0.01, 100.0), st.sampled_from([1, 3, 5]), st.booleans())
def test_steep_and_flat_functions_of_either_sign(
    root: float, power: int, falls: bool
) -> None:
    """A root of odd order p is known to the p-th root of the rounding of its function."""

    def function(at: Array) -> Array:
        values = (at / root - 1.0) ** power
        return np.asarray(-values if falls else values)

    (found,) = roots_between(function, np.array([0.1 * root]), np.array([7.0 * root]))
    assert found == pytest.approx(root, rel=4.0 * EPS if power == 1 else 1e-5)


def test_few_evaluations_are_enough() -> None:
    """Ridders' method doubles the digits with two evaluations."""
    calls = 0

    def counted(at: Array) -> Array:
        nonlocal calls
        calls += 1
        return np.asarray(np.exp(at) - 2.0)

    (found,) = roots_between(counted, np.array([-1.0]), np.array([3.0]))
    assert found == pytest.approx(math.log(2.0), rel=2.0 * EPS)
    # 53 digits: six doublings of the first, one step to see that it stays, two ends.
    assert calls <= 2 + 2 * 7
