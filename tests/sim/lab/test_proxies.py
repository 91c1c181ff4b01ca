"""Comparison of proxies: exact closed forms, better with detail, never through a plate."""

from __future__ import annotations

import itertools
import json
from pathlib import Path
from typing import Any

import pytest
from matplotlib.text import Text

from nodes.cli.main import main
from nodes.environment.shapes.tables import SKIN
from sim.lab.proxies import ProxyError
from sim.lab.studies.proxies import errors_over_time
from tests.support.launching import exit_code

# The first run on a machine compiles the geometry.


def test_the_study_tells_exact_shapes_from_meshes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [
        "lab",
        "proxies",
        "--finest",
        "3",
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
    assert [row["triangles"] for row in meshes] == [320, 1280]
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


def test_no_name_in_the_picture_covers_a_marker_or_another_name() -> None:
    """A mesh is named by its triangles: whole names lay over its neighbours."""
    facts: dict[str, Any] = {
        "rms_n": 0.1,
        "proxy_um": 1.0,
        "polyhedron_um": None,
        "drag": 0.0,
    }
    facts |= {"rounds": 1, "call_p99_us": 2.0}
    made = (
        ("plane", 0, 5e-8, 0.38),
        ("sphere", 0, 5e-8, 0.95),
        ("capsule", 0, 1.2e-7, 1.02),
        ("sphere of 320 triangles", 320, 0.5, 1.08),
        ("sphere of 1280 triangles", 1280, 0.16, 1.25),
        ("sphere of 5120 triangles", 5120, 0.09, 1.6),
    )
    rows = [
        ProxyError(name=n, triangles=t, max_n=e, noise_n=e, call_us=c, **facts)
        for n, t, e, c in made
    ]
    for axes in errors_over_time(rows).axes:
        for each in axes.texts:
            each.get_window_extent()
        names = [(each, Text.get_window_extent(each)) for each in axes.texts]
        assert {each.get_text() for each, _ in names} >= {"plane", "320", "5120"}
        for (_, one), (_, other) in itertools.combinations(names, 2):
            assert not one.overlaps(other)
        points = axes.transData.transform([(c, 1e3 * e) for _, _, e, c in made])
        assert not any(box.contains(*point) for _, box in names for point in points)


@pytest.mark.parametrize(
    "words", [["--finest", "9"], ["--ticks", "3"], ["--depth", "0.04"]]
)
def test_what_makes_no_sense_is_refused(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert exit_code("lab", "proxies", *words) == 2
    assert words[0] in capsys.readouterr().err
