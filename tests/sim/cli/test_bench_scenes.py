"""The benchmark of scenes: a row for each, launched, with what its environment takes."""

from __future__ import annotations

import json
from importlib.util import find_spec

import pytest

from nodes.cli.main import main
from sim.experiments.scene_costs import BODIES


# The first run on a machine compiles the ticks.
@pytest.mark.timeout(900)
def test_every_scene_has_its_row(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "loop", "--scenes", "--rounds", "1", "--seconds", "0.5", "--finest", "3", "--json"]) == 0
    rows = {row["scene"]: row for row in json.loads(capsys.readouterr().out.splitlines()[-1])["rows"]}
    bodies = set(BODIES) if find_spec("mujoco") else set()
    assert set(rows) == {"floor_drop", "sphere_feel", "mesh_pebble", "ball of 1280 triangles"} | bodies
    for name, row in rows.items():
        assert row["tick"] == ("plain" if name in bodies else "compiled")
        assert 0.0 < row["spent_us"]["p50"] <= row["spent_us"]["p99"]
        assert 0.0 < row["response_us"]["p50"] <= row["response_us"]["p99"]
        assert 0 <= row["missed"] <= row["ticks"]


def test_what_makes_no_sense_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    for words in (["--finest", "8"], ["--rounds", "0"], ["--seconds", "0"]):
        assert main(["bench", "loop", "--scenes", *words]) == 2
        assert words[0] in capsys.readouterr().err
