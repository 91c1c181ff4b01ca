"""Drawn shapes lie on the surfaces of the geometry."""

from __future__ import annotations

import base64
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from nodes.environment.bodies.node import MujocoParameters, load_world
from nodes.view.shape import _part, bodies_of, moves, patches_of, shape_of
from nodes.view.tessellation import Patch
from sim.lab.proxy_shapes import icosphere

Corners = NDArray[np.float64]

CUBE = """v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 1\nv 1 0 1\nv 1 1 1\nv 0 1 1
f 1 4 3 2\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n"""


def ball(p: Corners) -> Corners:
    return np.asarray(np.linalg.norm(p - [0.05, 0.01, -0.03], axis=1) - 0.035)


def turned_box(p: Corners) -> Corners:
    """Return a box rotated by 90° of yaw: first edge along y, second along −x."""
    local = (p - [0.01, 0.0, 0.0]) @ np.array(
        [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    )
    return np.asarray(np.abs(np.abs(local) - [0.01, 0.02, 0.03]).max(axis=1))


def rod(p: Corners) -> Corners:
    """Return the distance to a capsule of radius 10 mm along x, from 0 to 50 mm."""
    return np.asarray(
        np.linalg.norm(
            p - np.stack([np.clip(p[:, 0], 0.0, 0.05), 0 * p[:, 0], 0 * p[:, 0]], 1),
            axis=1,
        )
        - 0.01
    )


def can(p: Corners) -> Corners:
    """Return the distance to a cylinder of radius 10 mm along z, from 0 to 40 mm."""
    out, end = (
        np.hypot(p[:, 0], p[:, 1]),
        np.minimum(np.abs(p[:, 2]), np.abs(p[:, 2] - 0.04)),
    )
    return np.asarray(np.where(out < 0.005, end, np.maximum(np.abs(out - 0.01), end)))


@pytest.mark.parametrize(
    ("surface", "off"),
    [
        ({"kind": "sphere", "position": [0.05, 0.01, -0.03], "radius": 0.035}, ball),
        (
            {
                "kind": "box",
                "position": [0.01, 0.0, 0.0],
                "size": [0.02, 0.04, 0.06],
                "rotation": [0.0, 0.0, math.pi / 2],
            },
            turned_box,
        ),
        (
            {
                "kind": "capsule",
                "start": [0.0, 0.0, 0.0],
                "end": [0.05, 0.0, 0.0],
                "radius": 0.01,
            },
            rod,
        ),
        (
            {
                "kind": "cylinder",
                "start": [0.0, 0.0, 0.0],
                "end": [0.0, 0.0, 0.04],
                "radius": 0.01,
            },
            can,
        ),
        (
            {
                "kind": "oriented_plane",
                "position": [0.0, 0.01, 0.0],
                "normal": [0.0, 1.0, 1.0],
            },
            lambda p: p[:, 1] + p[:, 2] - 0.01,
        ),
        (
            {"kind": "mesh", "file": "cube.obj", "scale": 0.02},
            lambda p: np.minimum(np.abs(p), np.abs(p - 0.02)).max(1),
        ),
    ],
)
def test_every_corner_of_every_kind_lies_on_its_surface(
    surface: dict[str, Any], off: Any, tmp_path: Path
) -> None:
    if "file" in surface:
        (tmp_path / "cube.obj").write_text(CUBE, encoding="utf-8")
        surface = {**surface, "file": str(tmp_path / "cube.obj")}
    (patch,) = patches_of({"surface": surface})
    assert len(np.unique(patch.points, axis=0)) >= 8
    # Lengths below 1 m in double precision.
    assert np.abs(off(patch.points)).max() < 1e-15
    assert patch.closed == (surface["kind"] != "oriented_plane")
    if patch.closed:
        assert_closed_and_outward(patch)


def assert_closed_and_outward(patch: Patch) -> None:
    """Each edge has two triangles that pass it either way, and the volume is positive."""
    _, which = np.unique(np.round(patch.points, 9) + 0.0, axis=0, return_inverse=True)
    faces = which.reshape(-1)[patch.faces]
    edges = np.concatenate([faces[:, [k, (k + 1) % 3]] for k in range(3)])
    there = {tuple(edge) for edge in edges.tolist()}
    assert len(there) == len(edges)
    assert {(b, a) for a, b in there} == there
    a, b, c = np.moveaxis(patch.corners, 1, 0)
    assert np.einsum("ij,ij->", a, np.cross(b, c)) > 0.0


def read_part(part: dict[str, Any]) -> tuple[Corners, Any]:
    """Return corners [m] and triangles of a part, as a page decodes them."""
    points = np.frombuffer(base64.b64decode(part["points"]), dtype="<f4")
    kind = "<u4" if part["wide"] else "<u2"
    return points.reshape(-1, 3).astype(float), np.frombuffer(
        base64.b64decode(part["faces"]), dtype=kind
    ).reshape(-1, 3)


def test_a_page_reads_the_triangles_that_were_made() -> None:
    ball = {"kind": "sphere", "position": [0.05, 0.01, -0.03], "radius": 0.035}
    path = [[0.0, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.03]]
    rod = {"kind": "capsule", "start": [0, 0, 0], "end": [0.05, 0, 0], "radius": 0.01}
    surface = {"kind": "union", "shapes": [ball, {**rod, "motion": {"path": path}}]}
    shape = shape_of({"surface": surface})
    assert [part["pose"] for part in shape["parts"]] == [-1, 0]
    assert moves(shape)
    for part, patch in zip(
        shape["parts"], patches_of({"surface": surface}), strict=True
    ):
        points, faces = read_part(part)
        # Single precision, of lengths below 0.1 m.
        assert np.abs(points - patch.points).max() <= 2.0**-24 * 0.125
        assert np.array_equal(faces, patch.faces)


def test_more_corners_than_two_bytes_count_are_all_there() -> None:
    count = 70_000
    angle = np.linspace(0.0, 1.0, count)
    patch = Patch(
        np.stack([angle, angle**2, 0 * angle], 1), np.array([[0, 1, count - 1]])
    )
    _, faces = read_part(_part(patch))
    assert faces.tolist() == [[0, 1, 69_999]]


def test_every_triangle_of_a_fine_mesh_is_drawn(tmp_path: Path) -> None:
    """A mesh of 81 920 triangles was drawn as every fifth of them."""
    corners = icosphere(6, 0.03)
    record = np.dtype([("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")])
    rows = np.zeros(len(corners), dtype=record)
    rows["v"] = corners
    head = bytes(80) + np.uint32(len(rows)).tobytes()
    (tmp_path / "fine.stl").write_bytes(head + rows.tobytes())
    surface = {"kind": "mesh", "file": str(tmp_path / "fine.stl"), "scale": 1.0}
    (patch,) = patches_of({"surface": surface})
    assert len(patch.faces) == 20 * 4**6
    assert len(patch.points) == 10 * 4**6 + 2
    assert_closed_and_outward(patch)


BODIES = """<mujoco><asset><material name="red" rgba="0.8 0.1 0.1 1"/>
<mesh name="wedge" vertex="0 0 0 0.02 0 0 0 0.02 0 0 0 0.02"/>
<hfield name="hill" nrow="3" ncol="4" size="0.03 0.02 0.01 0.001"
 elevation="0 0 0 0 0 1 1 0 0 0 0 0"/></asset>
<worldbody><geom type="plane" size="0.1 0.1 0.1" pos="0 0 -0.05"/>
<geom type="hfield" hfield="hill" pos="0.1 0 -0.05"/>
<body name="tool"><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/>
<joint type="slide" axis="0 0 1"/><geom type="sphere" size="0.006" mass="0.05"/></body>
<body pos="0.05 0 0"><freejoint/><geom name="a" type="ellipsoid" size="0.01 0.02 0.03"/></body>
<body pos="0.1 0 0"><freejoint/><geom name="b" type="mesh" mesh="wedge" material="red"/></body>
<body pos="0.15 0 0"><freejoint/><geom name="c" type="cylinder" size="0.01 0.02" rgba="0 0 1 1"/>
</body><body pos="0.2 0 0"><freejoint/><geom type="box" size="0.01 0.01 0.01" rgba="1 1 1 0"
 mass="0.1"/></body></worldbody></mujoco>"""


def test_bodies_have_their_colours_and_every_kind_of_geom(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    (tmp_path / "bodies.xml").write_text(BODIES, encoding="utf-8")
    world = load_world(
        MujocoParameters(scene=str(tmp_path / "bodies.xml")), 0.002, "environment"
    )
    parts = bodies_of(world)["parts"]
    # The last geom cannot be seen, and is not drawn; poses are those of the geoms.
    assert [part["pose"] for part in parts] == list(range(6))
    assert [part["tool"] for part in parts] == [False, False, True, False, False, False]
    colours = {part["name"]: part["colour"] for part in parts if part["colour"]}
    assert colours == {"b": [0.8, 0.1, 0.1], "c": [0.0, 0.0, 1.0]}
    hill, _ = read_part(parts[1])
    # Elevation times height, on a grid of 60 by 40 mm, y from below.
    assert {tuple(row) for row in np.round(hill, 6).tolist() if row[2] > 0.0} == {
        (-0.01, 0.0, 0.01),
        (0.01, 0.0, 0.01),
    }
    egg, _ = read_part(parts[3])
    assert np.abs(np.linalg.norm(egg / [0.01, 0.02, 0.03], axis=1) - 1).max() < 1e-6


def test_a_flat_wall_is_a_patch_and_nothing_is_nothing() -> None:
    surface = {"kind": "plane", "axis": "x", "position": 0.02}
    (part,) = shape_of({"surface": surface})["parts"]
    points, _ = read_part(part)
    assert points[:, 0] == pytest.approx(0.02)
    assert np.ptp(points[:, 1]) == pytest.approx(0.16)
    assert not part["closed"]
    assert shape_of({"surface": {"kind": "free"}}) == {}
