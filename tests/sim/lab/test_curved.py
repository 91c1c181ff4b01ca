"""Laws on curved surfaces: energy on closed paths in both frames, K_max while sliding."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from nodes.cli.main import main
from nodes.launcher import launch_file
from sim.lab.curved import AlongTheWay, sliding_k_max, theory
from tests.support.pictures import assert_drawn

# The first run on a machine compiles the geometry.

PERIOD, DEPTH, SPEED, GAIN, STIFFNESS, RADIUS = 0.002, 2e-3, 0.2, 2.0, 800.0, 0.035


@pytest.fixture(scope="module")
def found(
    tmp_path_factory: pytest.TempPathFactory,
) -> dict[tuple[str, str, str], dict[str, float]]:
    from contextlib import redirect_stdout
    from io import StringIO

    out = StringIO()
    with redirect_stdout(out):
        folder = str(tmp_path_factory.mktemp("curved"))
        assert main(["lab", "curved", "--slides", "", "--json", "--out", folder]) == 0
    told = json.loads(out.getvalue().splitlines()[-1])
    assert_drawn(told["plot"], "energy given out", "rod of 6 mm", "gives out nothing")
    rows = told["ways"]
    return {(row["surface"], row["law"], row["frame"]): row for row in rows}


def test_only_axes_that_turn_give_out_nothing_on_smooth_ways(
    found: dict[tuple[str, str, str], dict[str, float]],
) -> None:
    for surface in ("plane", "sphere of 35 mm", "rod of 6 mm"):
        for law in ("pd", "pd_alpha"):
            # The proxy keeps 1e-10 m of skin; of forces of 1.6 N that is nothing.
            assert abs(found[surface, law, "surface"]["given_out"]) < 1e-6
    # The deflection turns at v/r, the way's speed on the surface: B d v/r against K d.
    for surface, radius in (("sphere of 35 mm", RADIUS), ("rod of 6 mm", 0.006)):
        expected = GAIN * math.sin(SPEED / radius * PERIOD) / PERIOD / STIFFNESS
        assert found[surface, "pd", "world"]["given_out"] == pytest.approx(
            expected, rel=0.02
        )


def test_a_mesh_kicks_less_in_axes_that_turn(
    found: dict[tuple[str, str, str], dict[str, float]],
) -> None:
    """In world axes a jump of the normal is a velocity of depth times jump per tick."""
    for surface in ("sphere of 320 triangles", "sphere of 5120 triangles"):
        for law in ("pd", "pd_alpha"):
            world, turned = (
                found[surface, law, frame] for frame in ("world", "surface")
            )
            assert turned["kicks_n"] < 0.2 * world["kicks_n"]
            assert world["given_out"] > 0.0 > turned["given_out"]


def test_at_a_concave_edge_neither_gives_out(
    found: dict[tuple[str, str, str], dict[str, float]],
) -> None:
    for law in ("pd", "pd_alpha"):
        for frame in ("world", "surface"):
            assert found["groove of 120°", law, frame]["given_out"] <= 0.0


@pytest.mark.parametrize("frame", ["world", "surface"])
def test_k_max_of_a_sliding_contact_is_that_of_one_axis(frame: str) -> None:
    launch = launch_file.read("sphere_feel", {"pace": "lockstep"})
    # Searched to 0.2 %; the ripple's growth over 75 ticks tells no more than another few tenths.
    assert sliding_k_max(launch, 0.02, frame) == pytest.approx(theory(PERIOD), rel=0.01)


def test_the_ends_of_the_search_are_not_told_as_k_max(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    launch = launch_file.read("sphere_feel", {"pace": "lockstep"})
    monkeypatch.setattr("sim.lab.curved.SEARCHED", (0.5, 0.6))
    assert sliding_k_max(launch, 0.02, "surface") == math.inf
    monkeypatch.setattr("sim.lab.curved.SEARCHED", (1.2, 1.3))
    assert sliding_k_max(launch, 0.02, "surface") == 0.0
    # A run that overflows has grown, though its growth is no number.
    monkeypatch.setattr("sim.lab.curved.growth", lambda *_: math.nan)
    assert sliding_k_max(launch, 0.02, "surface") == 0.0
    monkeypatch.setattr("sim.lab.curved.sliding_k_max", lambda *_: math.inf)
    monkeypatch.setattr(
        "sim.lab.curved.along_ways",
        lambda *_: [AlongTheWay("plane", "pd", "world", 0.0, 0.0, 0.0)],
    )
    assert (
        main(["lab", "curved", "--slides", "0.02", "--json", "--out", str(tmp_path)])
        == 0
    )
    out = capsys.readouterr().out
    assert [
        edge["k_max_n_per_m"] for edge in json.loads(out.splitlines()[-1])["edges"]
    ] == [None, None]


def test_what_makes_no_sense_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["lab", "curved", "--depth", "0.01"]) == 2
    assert main(["lab", "curved", "--slides", "fast"]) == 2
    assert "--slides fast" in capsys.readouterr().err
