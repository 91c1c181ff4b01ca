"""The recursive filter against scipy's, which takes too long to load for a command."""

from __future__ import annotations

import numpy as np
import pytest

from sim.device.filters import filtered


@pytest.mark.parametrize(
    ("numerator", "denominator"),
    [
        ([0.7, -0.2, 0.1], [1.0]),
        ([0.3], [1.0, -0.999]),
        ([0.0, 2.0, 1.0], [2.0, -3.2, 1.5]),
        # A pole at 0.5 within a pair on a ring of 0.99: three bands.
        ([1.0, -1.0], [1.0, -2.3, 1.8701, -0.485]),
    ],
)
@pytest.mark.parametrize("shape", [(400,), (2, 3, 40), (3, 1)])
def test_a_filter_from_rest_is_scipys(
    numerator: list[float], denominator: list[float], shape: tuple[int, ...]
) -> None:
    from scipy.signal import lfilter  # half a second for every worker

    samples = np.random.default_rng(3).normal(size=shape)
    wanted = lfilter(numerator, denominator, samples)
    found = filtered(numerator, denominator, samples)
    assert found.shape == shape
    # Some 10 roundings a sample, over the memory of the slowest pole, 1000 samples.
    size = float(np.abs(wanted).max(initial=0.0))
    assert np.abs(found - wanted).max(initial=0.0) <= 1e4 * np.finfo(float).eps * size
