"""The survey of meshes: each verdict, and that it notices what is felt wrongly."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from nodes.cli.main import main
from nodes.environment.shapes.mesh import prepare_mesh
from nodes.environment.shapes.mesh_report import write_mesh
from sim.lab.mesh_survey import WIDTH, MeshFelt, compare, inside, judge
from sim.lab.proxy_shapes import icosphere
from tests.support.launching import exit_code
from tests.support.shapes import Array, box_triangles, winding

# The first run on a machine compiles the geometry.

CUBE = box_triangles((20.0, 20.0, 20.0))


def write(path: Path, triangles: Array) -> None:
    write_mesh(
        path, triangles.reshape(-1, 3), np.arange(len(triangles) * 3).reshape(-1, 3)
    )


def test_each_file_is_counted_once_by_how_it_is_felt(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ball = icosphere(3, 30.0)
    write(tmp_path / "cube.obj", CUBE)
    write(tmp_path / "copy.obj", CUBE)
    write(tmp_path / "ball_with_hole.stl", ball[1:])
    write(tmp_path / "open_cube.obj", CUBE[2:])
    (tmp_path / "damaged.stl").write_bytes(b"no mesh")
    (tmp_path / "notes.txt").write_text("no mesh", encoding="ascii")
    assert main(["lab", "meshes", str(tmp_path), "--json"]) == 0
    found = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert found["counts"][str(tmp_path)] == {
        "as it is": 1,
        "with --close": 1,
        "as a sheet": 1,
        "refused": 1,
        "failed": 0,
        "wrongly": 0,
        "files": 4,
    }
    (refused,) = [row for row in found["rows"] if row["felt"] == "refused"]
    assert refused["file"] == "damaged.stl"
    assert "cut off" in refused["reason"]
    (tmp_path / "damaged.stl").unlink()
    assert main(["lab", "meshes", str(tmp_path)]) == 0
    assert "33.3% are felt as solids as they are, 66.7% with" in capsys.readouterr().out


@pytest.mark.slow
def test_a_mesh_felt_elsewhere_than_it_is_is_noticed() -> None:
    """Moved by 2 mm, and a cavity that is filled."""
    ball = icosphere(3, 0.5 * WIDTH)
    hollow = np.concatenate([ball, 0.5 * ball[:, ::-1]])
    moved = ball + np.array([0.002, 0.0, 0.0])
    for raw, felt in ((ball, moved), (hollow, ball), (moved, ball)):
        made = prepare_mesh(felt, False, "file")
        found = compare("file", MeshFelt.SOLID, made, raw, np.random.default_rng(0))
        assert found.wrong > 0
        assert found.reason


def test_the_truth_is_that_of_libigl_or_of_crossings() -> None:
    """Where faces disagree about outside, the winding number decides nothing."""
    ball = icosphere(2, 0.03)
    places = np.random.default_rng(1).uniform(-0.03, 0.03, (40, 3))
    truth = np.rint(winding(ball, places))
    assert 0 < truth.sum() < len(truth)
    assert np.array_equal(inside(ball, places), truth)
    assert np.array_equal(inside(ball[:, ::-1], places), truth)
    mixed = np.concatenate([ball[::2, ::-1], ball[1::2]])
    assert np.array_equal(inside(mixed, places), truth)


@pytest.mark.parametrize("source", ["no_such_package_or_folder", "."])
def test_a_source_without_meshes_is_refused(
    source: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert exit_code("lab", "meshes", source) == 2
    assert source in capsys.readouterr().err


def test_a_coordinate_that_is_not_finite_is_a_refusal(tmp_path: Path) -> None:
    (tmp_path / "wild.obj").write_text(
        "v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "ascii"
    )
    assert judge(tmp_path / "wild.obj").felt is MeshFelt.REFUSED
