"""Response times: percentiles against the sorted list, with whole blocks and without."""

from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st

from nodes.driver.response_times import BLOCK, ResponseTimes
from nodes.driver.state import BINS, RECENT


@given(
    st.lists(st.integers(0, 400), max_size=3 * BLOCK + 1),
    st.sampled_from([0.01, 0.5, 0.99, 1.0]),
)
def test_a_percentile_is_the_upper_end_of_the_microsecond_of_its_tick(
    halves: list[int], share: float
) -> None:
    """Times of whole and half microseconds, so that no bin's edge is met by rounding."""
    times = ResponseTimes()
    seconds = [(half + 0.5) * 0.5e-6 for half in halves]
    for one in seconds:
        times.add(one)
    assert times.count == len(seconds)
    assert times.longest == max(seconds, default=0.0)
    (found,) = times.percentiles(share)
    if not seconds:
        assert found == 0.0
        return
    # The first tick that at least this share of ticks does not exceed.
    place = max(math.ceil(share * len(seconds)), 1) - 1
    micro = int(sorted(seconds)[place] * 1e6)
    assert found == min((micro + 1) * 1e-6, max(seconds))


def test_what_is_longer_than_all_bins_is_told_as_the_longest() -> None:
    """The last bin counts all of them, so its percentile is the maximum."""
    times = ResponseTimes()
    edge = BINS * 1e-6
    for response in (0.5e-6, edge + 1e-3, edge + 2e-3):
        times.add(response)
    assert times.percentiles(0.3, 0.5, 1.0) == [1e-6, edge + 2e-3, edge + 2e-3]
    figures = times.summary_us()
    assert figures["max"] == figures["p999"] == round(1e6 * (edge + 2e-3), 1)
    assert ResponseTimes().summary_us() == dict.fromkeys(
        ("p50", "p99", "p999", "max"), 0.0
    )


def test_every_response_is_counted_once_when_the_newest_are_overwritten() -> None:
    times = ResponseTimes()
    number = 2 * RECENT + BLOCK + 3
    for k in range(number):
        times.add((k + 0.5) * 1e-6)
    assert times.count == number
    # Whole blocks are in the bins, the rest among the newest.
    assert sum(times.bins) == number - 3
    assert times.percentiles(1.0) == [times.longest] == [(number - 0.5) * 1e-6]
