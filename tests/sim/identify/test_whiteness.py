"""What is left is white or not, as models that hold say: at the edge, both sides."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sim.arrays import Array
from sim.identify.choose_model import _is_doubtful
from sim.identify.judge_fit import IMPROBABLE, SURE, Left, whiteness

DRAWS, WINDOWS, LENGTH = 40, 10, 200


def left_of(residual: Array, draws: Array) -> Left:
    """Return what a fit leaves, of which only colour matters here."""
    none = np.zeros((0,))
    return Left(residual, draws, 1.0, 1.0, none, none, none, none)


def coloured(rng: np.random.Generator, correlation: float) -> Array:
    """Draw windows of noise whose neighbours are correlated, of variance 1."""
    white = rng.standard_normal((WINDOWS, LENGTH))
    found = white.copy()
    for k in range(1, LENGTH):
        found[:, k] = (
            correlation * found[:, k - 1] + np.sqrt(1 - correlation**2) * white[:, k]
        )
    return np.asarray(found, dtype=np.float64)


@pytest.mark.parametrize("seed", range(4))
def test_noise_with_a_memory_is_improbable_and_without_any_is_not(seed: int) -> None:
    """Of 2000 samples a correlation of 0.2 is nine standard deviations of 1/√2000."""
    rng = np.random.default_rng(seed)
    draws = rng.standard_normal((DRAWS, WINDOWS, LENGTH))
    white = whiteness(left_of(coloured(rng, 0.0), draws))
    remembering = whiteness(left_of(coloured(rng, 0.2), draws))
    assert remembering < IMPROBABLE < white
    assert _is_doubtful(as_choice(remembering), [])
    assert not _is_doubtful(as_choice(white), [])


def as_choice(found: float) -> Any:
    """Stand for a choice of a model, whose whiteness alone is asked for."""
    return SimpleNamespace(whiteness=found)


def test_a_term_that_the_data_ask_for_is_a_doubt_however_white_the_rest() -> None:
    below, above = (SimpleNamespace(strength=share * SURE) for share in (0.99, 1.01))
    assert not _is_doubtful(as_choice(0.5), [below])  # type: ignore[list-item]
    assert _is_doubtful(as_choice(0.5), [below, above])  # type: ignore[list-item]
