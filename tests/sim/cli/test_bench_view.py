"""`haptic bench view`: a page in a real browser beside a launch, and the memory of a view."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from sim.cli.bench.view import memory
from tests.support.browser import needs_browser
from tests.support.launching import haptic


@needs_browser
@pytest.mark.slow
@pytest.mark.process
@pytest.mark.realtime
def test_both_halves_of_a_round_and_the_delays_of_a_page_are_measured(
    tmp_path: Path,
) -> None:
    words = (
        "--rounds",
        "1",
        "--seconds",
        "0.5",
        "--minutes",
        "0.1",
        "--picture",
        "page.png",
    )
    figures = json.loads(haptic(tmp_path, "bench", "view", *words, "--json").stdout)
    for half in ("without", "with"):
        assert 0.0 < figures[half]["p50_us"][0] <= figures[half]["p99_us"][0]
        # Half a second at 500 Hz, or longer where the browser is slow.
        assert figures[half]["ticks"] > 100
    waits = ("first_picture_s", "map_s", "kept_map_s")
    for name in (*waits, "switch_s", "hand_to_picture_s", "hand_to_force_s"):
        assert figures[name] > 0.0
    assert (
        figures["p50_ratio"]
        == figures["with"]["p50_us"][0] / figures["without"]["p50_us"][0]
    )
    assert (tmp_path / "page.png").read_bytes().startswith(b"\x89PNG")


def test_the_memory_of_a_view_does_not_grow_with_the_minutes() -> None:
    """A minute of ticks fills its plots; ten more seconds of states would be 1 MB if kept."""
    found = memory(1.2, 500.0)
    assert 0.0 < found["after_one_minute_mb"] <= found["at_the_end_mb"] + 1.0
    assert found["at_the_end_mb"] - found["after_one_minute_mb"] < 3.0
