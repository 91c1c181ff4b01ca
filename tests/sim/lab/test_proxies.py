"""Comparison of proxies: exact closed forms, better with detail, never through a plate."""

from __future__ import annotations

import itertools
import json
from pathlib import Path

import pytest

from nodes.cli.main import main
from nodes.environment.shapes.tables import SKIN
from tests.support.launching import exit_code

# The first run on a machine compiles the geometry.


def test_the_study_tells_exact_shapes_from_meshes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [
        "lab",
        "proxies",
        "--finest",
        "4",
        "--ticks",
        "600",
        "--steps",
        "100000",
        "--json",
    ]
    assert main([*words, "--out", str(tmp_path)]) == 0
    assert (tmp_path / "proxies.pdf").stat().st_size > 1000
    figures = json.loads(capsys.readouterr().out.splitlines()[-1])
    rows = {row["name"]: row for row in figures["rows"]}
    for name in ("plane", "sphere", "capsule"):
        # Of the closed form it keeps the skin's distance, and rounding.
        assert rows[name]["max_n"] == pytest.approx(500.0 * SKIN, rel=1e-3)
        assert rows[name]["rounds"] <= 5
    meshes = [row for row in figures["rows"] if row["triangles"]]
    assert [row["triangles"] for row in meshes] == [320, 1280, 5120]
    # On the flat triangles it is exact, to rounding; that these are not the sphere is the mesh's
    # doing.
    assert all(row["polyhedron_um"] < 1e-6 for row in meshes)
    assert rows["sphere"]["polyhedron_um"] is None
    # Half the edges: a quarter of the height over them, half of the angle between them.
    for coarse, fine in itertools.pairwise(meshes):
        assert 1.5 < coarse["rms_n"] / fine["rms_n"] < 4.5
    assert all(row["drag"] < 1e-6 for row in figures["rows"])
    assert all(0.0 < row["call_us"] <= row["call_p99_us"] for row in figures["rows"])
    assert figures["plate"]["wrong_side"] == 0
    assert figures["plate"]["aside_max_m"] < 1e-12


@pytest.mark.parametrize(
    "words", [["--finest", "9"], ["--ticks", "3"], ["--depth", "0.04"]]
)
def test_what_makes_no_sense_is_refused(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert exit_code("lab", "proxies", *words) == 2
    assert words[0] in capsys.readouterr().err
