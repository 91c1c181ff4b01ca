"""Velocity by adaptive windowing: deviations on both sides, corners detected at once."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from nodes.laws.pd_windowed import windowed_slope

STEP = 2.3e-5


@given(st.lists(st.integers(-40, 40), min_size=22, max_size=22), st.integers(1, 20))
def test_the_slope_of_a_mirrored_motion_is_mirrored(
    counts: list[int], window: int
) -> None:
    ring = [STEP * count for count in counts]
    mirrored = windowed_slope([-x for x in ring], 0, STEP, window)
    # The same operations with the other sign: the same bits.
    assert mirrored == -windowed_slope(ring, 0, STEP, window)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_corner_is_seen_at_once_both_ways(sign: float) -> None:
    """Rest, then five steps a tick: after three samples the slope is that of the motion."""
    samples = [0.0] * 30 + [sign * 5.0 * STEP * k for k in range(1, 4)]
    slope = windowed_slope(samples[::-1], 0, STEP, 20)
    # The line over n samples misses one at the corner by 5·(n − 3)·3/n steps: within one step no
    # longer than the motion is.
    assert slope == pytest.approx(sign * 5.0 * STEP, rel=1e-12)
