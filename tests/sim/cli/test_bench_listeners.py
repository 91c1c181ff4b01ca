"""``haptic bench listeners``: halves with and without a stream of one launch."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.support.launching import haptic


@pytest.mark.process
@pytest.mark.slow
def test_a_stream_is_attached_in_every_second_half(tmp_path: Path) -> None:
    words = ("listeners", "--stream", "--rounds", "2", "--seconds", "0.5", "--json")
    found = json.loads(haptic(tmp_path, "bench", *words).stdout)
    assert found["p50_ratio"] > 0.0
    for half in ("without_us", "with_us"):
        assert 0.0 < found[half]["p50"] <= found[half]["p99"]
    assert found["lost_by_own_logger"] == 0
