"""haptic mesh: what it says of a file, and what --close writes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nodes.cli.main import main
from nodes.environment.shapes.mesh_file import read_triangles
from sim.lab.proxy_shapes import icosphere
from tests.support import ROOT
from tests.support.shapes import box_triangles, winding

FIXTURES = ROOT / "tests/fixtures/begin"


def described(
    capsys: pytest.CaptureFixture[str], *words: str, code: int = 0
) -> dict[str, Any]:
    assert main(["mesh", *words, "--json"]) == code
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


def write(path: Path, triangles: Any) -> Path:
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in triangles.reshape(-1, 3).tolist()]
    lines += [f"f {3 * n + 1} {3 * n + 2} {3 * n + 3}" for n in range(len(triangles))]
    path.write_text("\n".join(lines), encoding="ascii")
    return path


def test_a_file_of_another_program_is_described(
    capsys: pytest.CaptureFixture[str],
) -> None:
    found = described(capsys, str(FIXTURES / "two_cubes_one_inverted.obj"))
    assert (found["faces"], found["triangles"]) == ({"4": 12}, 24)
    assert (found["shells"], found["closed_shells"], found["cavities"]) == (2, 2, 0)
    assert found["repairs"] == {"turned_shells": 1}
    assert found["is_solid"]
    assert [one["unit"] for one in found["units"] if one["is_likely"]] == ["mm"]
    assert found["scale"] == 1e-3
    assert main(["mesh", str(FIXTURES / "two_cubes_one_inverted.obj")]) == 0
    assert "1 of 2 shells pointed inwards and were flipped" in capsys.readouterr().out


def test_at_a_given_scale_it_says_what_the_scene_says(
    capsys: pytest.CaptureFixture[str],
) -> None:
    found = described(capsys, str(FIXTURES / "bom.obj"), "--scale", "1")
    assert "60 m wide" in found["refusal"]
    assert not found["is_solid"]
    assert found["cavities"] == 1


@pytest.mark.parametrize(("offset", "crosses"), [(0.03, False), (0.013, True)])
def test_shells_that_cross_are_found(
    offset: float, crosses: bool, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    cube = box_triangles((0.02, 0.02, 0.02))
    path = write(tmp_path / "two.obj", np.concatenate([cube, cube + offset]))
    assert (described(capsys, str(path))["crossings"] > 0) == crosses


def test_small_holes_are_closed_on_request(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    ball = icosphere(4, 0.04)
    hub = ball[0, 0]
    far = np.linalg.norm(ball.mean(axis=1) - hub, axis=1) > 0.0022
    assert 4 < (~far).sum() < 30
    path = write(tmp_path / "open.obj", ball[far])
    found = described(capsys, str(path))
    assert not found["is_solid"]
    assert found["is_sheet"]
    assert len(found["holes"]) == 1
    assert "haptic mesh FILE --close OUT" in found["refusal"]
    for name, precision in (("closed.obj", 1e-15), ("closed.stl", 1e-8)):
        out = tmp_path / name
        made = described(capsys, str(path), "--close", str(out))
        assert made["close"] == {
            "file": str(out),
            "filled": 1,
            "pieces_left_out": 0,
            "holes_left": [],
            "refusal": "",
        }
        closed = read_triangles(out, "file")
        places = np.array([[0.0, 0.0, 0.0], 1.1 * hub, 0.9 * hub])
        within = winding(closed, places)
        assert np.rint(within).tolist() == [1.0, 0.0, 1.0]
        assert np.abs(within - np.rint(within)).max() < 1e-6
        # What was there is there still.
        kept = closed.reshape(-1, 3)[:, None] - ball[far][:50].reshape(-1, 3)
        assert np.abs(kept).max(axis=2).min(axis=0).max() <= precision
        assert described(capsys, str(out))["is_solid"]


def test_a_large_hole_is_left_and_the_exit_code_says_so(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path = write(tmp_path / "open.obj", box_triangles((0.02, 0.02, 0.02))[:-1])
    made = described(capsys, str(path), "--close", str(tmp_path / "out.stl"), code=1)
    assert made["close"]["filled"] == 0
    assert [one["edges"] for one in made["close"]["holes_left"]] == [3]


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["none.stl"], "none.stl cannot be read: No such file"),
        (["a.3ds"], "neither an .stl, .obj, .ply nor .off file"),
        (
            ["bom.obj", "--close", "out.ply"],
            "expected a name that ends with .stl or .obj",
        ),
        (["bom.obj", "--close", "bom.obj"], "exists already; choose another name"),
        (
            ["bom.obj", "--close", "bom.obj/x.stl"],
            "is not a directory; choose another --close",
        ),
    ],
)
def test_a_wrong_command_is_refused(
    words: list[str],
    told: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    (tmp_path / "bom.obj").write_bytes((FIXTURES / "bom.obj").read_bytes())
    monkeypatch.chdir(tmp_path)
    assert main(["mesh", *words]) == 2
    assert told in capsys.readouterr().err


def test_single_precision_far_from_the_origin_is_refused(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Its step there is 2^-24 of the coordinate; corners within 1e-6 of the width are joined."""
    ball = np.delete(icosphere(2, 0.05), 7, axis=0)
    for far, fits in ((0.5, True), (5.0, False)):
        path = write(tmp_path / f"at_{far}.obj", ball + far)
        out = tmp_path / f"at_{far}.stl"
        code = main(["mesh", str(path), "--close", str(out)])
        assert ((code == 0), out.exists()) == (fits, fits)
        assert ("name it .obj" in capsys.readouterr().err) is not fits
        described(capsys, str(path), "--close", str(out.with_suffix(".OBJ")))
