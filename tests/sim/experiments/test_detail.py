"""Level of detail: the required detail of boxes and balls of triangles is found."""

from __future__ import annotations

import itertools
import json
from pathlib import Path

import numpy as np
import pytest

from nodes.cli.main import main
from nodes.environment.shapes.mesh import prepare_mesh
from nodes.environment.shapes.scene import (
    SLIPPERY,
    Factors,
    FeltRegion,
    Friction,
    box,
    mesh,
    plane,
)
from nodes.environment.shapes.tables import VISCOSITY
from nodes.laws.parse import compile_law, parse_law
from sim.experiments.detail import Detail, detail
from sim.lab.proxy_shapes import icosphere, ring
from tests.support import ROOT
from tests.support.pictures import assert_drawn
from tests.support.shapes import Array, box_triangles, turned

# The first run on a machine compiles the geometry.

PERIOD, STIFFNESS, RESOLUTION = 1e-3, 1000.0, 1e-5


def judged(
    triangles: Array, path: Array, friction: Friction = SLIPPERY, fraction: float = 0.0
) -> Detail:
    return detail(
        [mesh(prepare_mesh(triangles, False, "file"), friction)],
        path,
        0.0,
        PERIOD,
        STIFFNESS,
        RESOLUTION,
        fraction,
    )


def over_an_edge() -> Array:
    """Lead over a box 20 mm high, 1 mm deep, around an edge, down a side, and back."""
    corners = np.array(
        [
            [0.0, 0.0, 0.02],
            [0.0, 0.0, 0.009],
            [0.021, 0.004, 0.009],
            [0.021, 0.004, 0.012],
            [0.019, 0.004, 0.005],
            [0.03, 0, 0],
        ]
    )
    return np.concatenate(
        [np.linspace(a, b, 60) for a, b in itertools.pairwise(corners)]
    )


def test_a_box_of_triangles_needs_a_box() -> None:
    turn = (0.3, -0.2, 0.5)
    found = judged(
        turned(box_triangles((0.04, 0.06, 0.02)), *turn), turned(over_an_edge(), *turn)
    )
    # 1 mm deep, and rounding; no part of the force was allowed.
    assert found.largest_n == pytest.approx(1.0, rel=1e-3)
    assert found.limit_n == found.force_step_n == STIFFNESS * RESOLUTION
    assert found.coarsest.name == "box"
    levels = {level.name: level for level in found.levels}
    # Corners by singular values: to the digits of a length of a few centimetres, times some.
    assert levels["box"].proxy_um < 1e-6
    assert levels["1 convex piece"].proxy_um < 1e-6
    for name in ("sphere", "capsule", "plane"):
        assert not levels[name].enough
        assert levels[name].places >= 1
    assert all(0.0 < level.call_us <= level.call_p99_us for level in found.levels)


@pytest.mark.parametrize(("halvings", "needs"), [(4, "sphere"), (1, "1 convex piece")])
def test_a_ball_needs_a_sphere_once_its_triangles_are_fine(
    halvings: int, needs: str
) -> None:
    """An edge a lies a²/8r below the sphere: 20 µm for 5120 triangles, over 1 mm for 80."""
    on, out = ring(400, 0.2, PERIOD, 0.05)
    depth = np.minimum(np.arange(400) / 20.0, 1.0)[:, None] * 4e-3 - 1e-4
    found = judged(icosphere(halvings, 0.05), on - depth * out, fraction=0.1)
    assert found.coarsest.name == needs
    assert not next(level for level in found.levels if level.name == "plane").enough


def test_friction_that_is_felt_is_needed() -> None:
    found = judged(
        box_triangles((0.04, 0.06, 0.02)), over_an_edge(), Friction(0.3, 0.3)
    )
    smooth = next(level for level in found.levels if level.name == "without friction")
    assert not smooth.enough
    # Drawn along 1 mm deep, it trails by 0.3 of that.
    assert smooth.force_n >= 0.3 * STIFFNESS * 1e-3 * 0.99
    assert found.coarsest.name == "box"


@pytest.mark.parametrize(
    ("factors", "largest", "differs"),
    [
        # K e with e = 1 mm at the end; the factor takes half of it.
        (Factors(0.5, 1.0), 0.5, 0.5),
        # B v = 2 N s/m times 20 mm/s on the way in; at rest nothing is left of it.
        (Factors(1.0, 0.25), 1.0, 0.75 * 2.0 * 0.02),
        (Factors(0.995, 1.0), 0.995, 0.005),
    ],
)
def test_factors_that_are_felt_are_needed(
    factors: Factors, largest: float, differs: float
) -> None:
    speed, depth = 0.02, 1e-3
    way = np.minimum(np.arange(100) * speed * PERIOD, depth)[:, None]
    pressed = 0.01 - way * np.array([0.0, 0.0, 1.0])
    pressed[:, :2] = 0.0
    wall = plane((0.0, 0.0, 0.01), (0.0, 0.0, 1.0))._replace(factors=factors)
    law = parse_law({"kind": "pd", "stiffness": STIFFNESS, "damping": 2.0}, "law")
    compiled = compile_law(law, PERIOD, "law")
    limits = PERIOD, STIFFNESS, RESOLUTION, 0.0
    found = detail([wall], pressed, 0.0, *limits, law=compiled)
    levels = {level.name: level for level in found.levels}
    # The proxy stays 0.1 nm above the surface: relative 1e-7 of a millimetre.
    assert found.largest_n == pytest.approx(largest, rel=1e-6)
    whole = levels["without factors"]
    # On arrival a tick's force at rest is short of the whole depth by v T: 2 % of it.
    assert whole.force_n == pytest.approx(differs, rel=1e-3 if differs > 0.2 else 0.03)
    assert whole.enough == (differs <= found.limit_n)
    assert (found.coarsest.name == "as it is") == (differs > found.limit_n)


def test_coarser_shapes_have_the_factors_of_what_they_replace() -> None:
    """A box of triangles is the same box, however soft its law is."""
    soft = mesh(prepare_mesh(box_triangles((0.04, 0.06, 0.02)), False, "file"))
    soft = soft._replace(factors=Factors(0.3, 0.6))
    loop = PERIOD, STIFFNESS, RESOLUTION, 0.0
    found = detail([soft], over_an_edge(), 0.0, *loop)
    assert found.largest_n == pytest.approx(0.3, rel=1e-3)
    levels = {level.name: level for level in found.levels}
    assert found.coarsest.name == "box"
    assert not levels["without factors"].enough


def test_a_path_in_the_air_is_refused() -> None:
    with pytest.raises(ValueError, match="touches nothing"):
        judged(box_triangles((0.04, 0.06, 0.02)), np.full((10, 3), 0.1))


def test_a_region_that_is_felt_is_needed() -> None:
    """Through a viscous one at a constant speed the proxy trails by speed times its time."""
    speed, lag = 0.1, 0.02
    way = np.arange(600)[:, None] * speed * PERIOD * np.array([1.0, 0.0, 0.0])
    region = FeltRegion(
        box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)), VISCOSITY, band=0.002, lag=lag
    )
    far = [plane((0.0, 0.0, -0.4), (0.0, 0.0, 1.0))]
    found = detail(far, way, 0.0, PERIOD, STIFFNESS, RESOLUTION, 0.0, regions=[region])
    levels = {level.name: level for level in found.levels}
    assert list(levels) == ["as it is", "without regions"]
    assert found.left_out == ("coarser shapes: the path touches no shape",)
    # After 30 time constants nothing is left of the start.
    assert levels["without regions"].force_n == pytest.approx(
        STIFFNESS * speed * lag, rel=1e-9
    )
    assert not levels["without regions"].enough
    assert found.coarsest.name == "as it is"


def test_shapes_that_move_are_not_judged(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    text = (ROOT / "launch" / "sphere_feel.yaml").read_text("utf-8")
    moves = "motion: {path: [[0, 0, 0, 0], [1, 0.01, 0, 0]]}"
    indent = "kind: sphere\n        "
    assert indent in text
    (tmp_path / "own.yaml").write_text(
        text.replace(indent, f"{indent}{moves}\n        "), encoding="utf-8"
    )
    assert main(["study", "detail", str(tmp_path / "own.yaml")]) == 2
    assert "shapes that move are not judged" in capsys.readouterr().err


@pytest.mark.slow
def test_the_study_leads_a_real_run_through_the_levels(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert (
        main(
            [
                "study",
                "detail",
                "rough_plane",
                "duration:=1.2",
                "--json",
                "--out",
                str(tmp_path),
            ]
        )
        == 0
    )
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert_drawn(
        told["plot"], "without friction", "no difference: up to", "time of a call"
    )
    assert [level["name"] for level in told["levels"]] == [
        "as it is",
        "without friction",
    ]
    assert told["needs"] == "as it is"
    # A Touch X's encoder step, times the stiffness.
    assert told["force_step_n"] == pytest.approx(800.0 * 2.3e-5)
    assert main(["study", "detail", "floor_drop"]) == 2
    assert "has one level of detail" in capsys.readouterr().err


def test_bodies_are_led_held_and_left_out(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    pytest.importorskip("mujoco")
    assert (
        main(
            [
                "study",
                "detail",
                "stack_boxes",
                "duration:=1.2",
                "--json",
                "--out",
                str(tmp_path),
            ]
        )
        == 0
    )
    found = json.loads(capsys.readouterr().out.splitlines()[-1])
    levels = {level["name"]: level for level in found["levels"]}
    assert list(levels) == [
        "dynamic",
        "dynamic, without friction",
        "kinematic: led as they went",
        "fixed",
        "a tool alone",
    ]
    # The finest is its own measure.
    assert levels["dynamic"]["force_n"] == 0.0
    assert levels["dynamic"]["enough"]
    # A body that goes where it went gives way a little less than one that is pushed there; one that
    # is held does not at all.
    assert levels["kinematic: led as they went"]["force_n"] < levels["fixed"]["force_n"]
    assert not levels["fixed"]["enough"]
    # Without any contact the tool keeps to the device, and all of the force from pushing is gone.
    assert levels["a tool alone"]["force_n"] > 0.5 * found["largest_n"]
    assert all(
        0.0 < level["call_us"] <= level["call_p99_us"] for level in levels.values()
    )


OWN = """summary: somebody's own
run: {rate: 500.0, duration: 0}
nodes:
  driver:
    kind: sim_driver
    parameters:
      device: {mass: 0.1, damping: 1.0, hand: {stiffness: 150.0, path: [[0.2, 0.0], [0.4, 0.03]]}}
  environment:
    kind: environment
    parameters: {surface: {kind: sphere, position: [0.05, 0, 0], radius: 0.04}}
  coupling: {kind: coupling, parameters: {law: pd, laws: {pd: {kind: pd, stiffness: 800.0}}}}
"""


def test_the_study_plays_a_file_by_a_relative_path_without_arguments(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A run without an end is played for as long as every study plays it."""
    (tmp_path / "own.yaml").write_text(OWN, encoding="ascii")
    monkeypatch.chdir(tmp_path)
    words = "study detail ./own.yaml run.duration:=0.6 --out out"
    assert main(words.split()) == 0
    printed = capsys.readouterr().out.splitlines()
    assert printed[0].startswith("own: H(1) 800 N/m")
    assert any(line.startswith("as it is  ") for line in printed)
    assert any(line.startswith("this scene needs: ") for line in printed)
    largest = float(printed[0].partition("largest force ")[2].split()[0])
    # the hand ends 30 mm beyond its start, 20 mm inside the ball, and gives way
    assert 1.0 < largest < 800.0 * 0.02
