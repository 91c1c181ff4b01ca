"""Time spent per tick by an environment: what is counted, and what a launch reports."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from nodes.environment.spent import (
    BINS,
    PER_OCTAVE,
    SHORTEST_SPENT,
    note_spent,
    spent_us,
)
from tests.support.launching import launch_json


def test_quantiles_are_those_of_the_times_to_the_width_of_a_bin() -> None:
    times = np.exp(np.random.default_rng(0).normal(np.log(8e-6), 0.7, 20_000))
    counts = [0] * BINS
    for time in times.tolist():
        note_spent(counts, time)
    assert sum(counts) == len(times)
    told = spent_us(counts)
    half = 2.0 ** (0.5 / PER_OCTAVE) - 1.0
    for name, part in (("p50", 0.5), ("p99", 0.99), ("p999", 0.999)):
        # Half a bin, and the three digits that are told.
        assert told[name] == pytest.approx(
            1e6 * np.quantile(times, part), rel=half + 0.01
        )
    assert (
        1e6 * times.max() * 0.995
        <= told["max"]
        <= 1e6 * times.max() * (1.0 + 2.1 * half)
    )


def test_what_is_too_short_or_too_long_for_the_bins_is_counted_in_the_outermost() -> (
    None
):
    counts = [0] * BINS
    for time in (0.0, -1e-9, 0.5 * SHORTEST_SPENT, 1e3):
        note_spent(counts, time)
    assert (counts[0], counts[-1], sum(counts)) == (3, 1, 4)
    assert spent_us([0] * BINS) == {}


@pytest.mark.process
def test_a_launch_tells_it_in_real_time_only(tmp_path: Path) -> None:
    """In lockstep no clock is read, so that runs repeat to the bit."""
    words = ("--tick", "plain", "--without", "logger", "duration:=0.4")
    told = launch_json(tmp_path, "floor_drop", *words)["spent_us"]["environment"]
    assert 0.0 < told["p50"] <= told["p99"] <= told["p999"] <= told["max"]
    assert (
        launch_json(tmp_path, "floor_drop", *words, "pace:=lockstep")["spent_us"] == {}
    )
