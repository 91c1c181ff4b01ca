"""Meshes: what is read, what is repaired, and what is refused, with which text."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from messages.topics import event
from nodes.environment.shapes.mesh import prepare_mesh
from nodes.environment.shapes.mesh_file import LARGEST, read_triangles
from nodes.environment.shapes.scene import mesh
from nodes.environment.surfaces import parse_surface
from nodes.parameters.store import ParameterError
from nodes.recording.reader import Recording
from sim.lab.proxy_shapes import icosphere
from sim.play.touch import touch
from tests.support.launching import launch_json
from tests.support.shapes import Array, box_triangles

CUBE = box_triangles((0.02, 0.02, 0.02))


def binary_stl(triangles: Array) -> bytes:
    records = [
        struct.pack("<12fH", 0.0, 0.0, 0.0, *triangle.ravel(), 0)
        for triangle in triangles
    ]
    return (
        b"solid in name only".ljust(80)
        + struct.pack("<I", len(triangles))
        + b"".join(records)
    )


def text_stl(triangles: Array) -> bytes:
    facets = (
        "facet normal 0 0 0\nouter loop\n"
        + "".join(f"vertex {x!r} {y!r} {z!r}\n" for x, y, z in triangle.tolist())
        + "endloop\nendfacet\n"
        for triangle in triangles
    )
    return f"solid cube\n{''.join(facets)}endsolid cube\n".encode()


def obj(triangles: Array) -> bytes:
    """Return OBJ text: corners once, faces by number from either end, with slashes."""
    points, ids = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in points.tolist()]
    for n, (a, b, c) in enumerate(ids.reshape(-1, 3).tolist()):
        lines.append(
            f"f {a + 1}//1 {b + 1}/1/1 {c + 1}"
            if n % 2
            else f"f {a - len(points)} {b - len(points)} {c - len(points)}"
        )
    return "\n".join(["# a cube", "vn 0 0 1", *lines, ""]).encode()


@pytest.mark.parametrize(
    ("name", "written"),
    [("a.stl", binary_stl(CUBE)), ("b.STL", text_stl(CUBE)), ("c.obj", obj(CUBE))],
)
def test_each_format_gives_the_triangles(
    name: str, written: bytes, tmp_path: Path
) -> None:
    (tmp_path / name).write_bytes(written)
    found = read_triangles(tmp_path / name, "surface.file")
    # Binary STL is single precision.
    assert np.abs(found - CUBE).max() < 1e-9
    prepared = prepare_mesh(found, False, "surface.file")
    assert prepared.closed
    assert prepared.repairs == ()


def test_an_obj_face_of_four_corners_is_two_triangles(tmp_path: Path) -> None:
    (tmp_path / "quad.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n", encoding="ascii"
    )
    assert read_triangles(tmp_path / "quad.obj", "file").shape == (2, 3, 3)


@pytest.mark.parametrize(
    ("name", "written", "told"),
    [
        (
            "a.3ds",
            b"MM",
            "is neither an .stl, .obj, .ply nor .off file, nor .3mf, .glb or .gltf; ",
        ),
        ("a.ply", b"ply", "is no PLY file"),
        (
            "a.ply",
            b"ply\nformat ascii 1.0\nelement face 1\n"
            b"property list int int vertex_indices\nend_header\n3 inf nan 0\n",
            "cannot convert float infinity",
        ),
        (
            "a.ply",
            b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\n"
            b"property list int int vertex_indices\nend_header\n0.5\n",
            "has a vertex without vertex_indices",
        ),
        ("a.off", b"OFF\n3 1 0\n0 0 0\n", "is cut off: 1 of 3 corners, 0 of 1 faces"),
        ("a.stl", binary_stl(CUBE)[:-7], "cut off"),
        ("a.stl", text_stl(CUBE).rpartition(b"vertex")[0], "cut off"),
        ("a.stl", b"", "is empty"),
        ("a.stl", text_stl(CUBE).replace(b"vertex 0.01", b"vertex abc", 1), "line 1"),
        ("a.obj", b"v 0 0\n", "line 1: 2 coordinates, expected 3"),
        ("a.stl", b" " * 84, "cut off: 84 bytes"),
        ("a.stl", b"\x00" * 84, "has no triangles: its header says 0"),
        ("a.stl", b"solid nothing\nendsolid nothing\n", "has no triangles"),
        ("a.obj", b"v 0 0 0\nf 1 2 3\n", "line 2: corner 3, but the file has 1"),
        (
            "a.obj",
            b"v 0 0 0\nf -1 -2 -3\n",
            "line 2: corner -2, but 1 are known so far",
        ),
        ("a.obj", b"v 0,5 1,0 2,0\n", "line 1: .*; write decimals with a point"),
        ("a.obj", b"v 0 0 0\nf 1 x 3\n", "line 2: 'x' names no corner"),
        ("a.obj", b"v 0 0 0\n", "has no triangles"),
    ],
)
def test_a_file_that_is_no_mesh_is_refused(
    name: str, written: bytes, told: str, tmp_path: Path
) -> None:
    (tmp_path / name).write_bytes(written)
    with pytest.raises(ParameterError, match=told) as refused:
        read_triangles(tmp_path / name, "environment.surface.file")
    assert str(refused.value).startswith(f"environment.surface.file: {tmp_path / name}")


def test_a_file_of_ten_gigabytes_is_refused_unread(tmp_path: Path) -> None:
    with open(tmp_path / "huge.stl", "wb") as file:
        file.truncate(10_000_000_000)
    with pytest.raises(
        ParameterError, match=f"10000 MB, more than {LARGEST // 1_000_000}; decimate"
    ):
        read_triangles(tmp_path / "huge.stl", "file")
    with pytest.raises(ParameterError, match="No such file"):
        read_triangles(tmp_path / "none.stl", "file")
    (tmp_path / "folder.stl").mkdir()
    with pytest.raises(ParameterError, match="is not a file"):
        read_triangles(tmp_path / "folder.stl", "file")


def test_a_mesh_turned_inside_out_is_turned_back_and_told() -> None:
    prepared = prepare_mesh(CUBE[:, ::-1], False, "file")
    assert prepared.repairs == ("file: all faces pointed inwards and were flipped",)
    outward = np.einsum("ij,ij->i", prepared.normals, prepared.corners.mean(axis=1))
    assert (outward > 0.0).all()


def test_a_triangle_without_three_corners_is_left_out_and_told() -> None:
    squeezed = np.concatenate([CUBE, CUBE[:1, [0, 0, 1]]])
    assert prepare_mesh(squeezed, False, "file").repairs == (
        "file: 1 triangles of fewer than three corners left out",
    )


@pytest.mark.parametrize(
    ("triangles", "told"),
    [
        (CUBE[:-1], "the mesh is open: 3 edges have one triangle only.*sides: both"),
        (
            np.where(np.arange(12)[:, None, None] == 5, np.nan, CUBE),
            "triangle 5 has a coordinate that is not finite",
        ),
        (1000.0 * CUBE, "the mesh is 20 m wide.*scale: 0.001"),
        (1e-3 * CUBE, "the mesh is 2e-05 m wide.*its scale is too small"),
        (
            np.array([[[0.0, 0.0, 0.0], [0.01, 0.0, 0.0], [0.02, 0.0, 0.0]]]),
            "no triangle has an area",
        ),
    ],
)
def test_a_mesh_that_bounds_nothing_is_refused(triangles: Array, told: str) -> None:
    with pytest.raises(ParameterError, match=told):
        prepare_mesh(triangles, False, "environment.surface.file")


def test_every_triangle_is_in_its_boxes_and_knows_its_neighbours() -> None:
    prepared = prepare_mesh(icosphere(3, 0.05), False, "file")
    count, leaves = len(prepared.corners), prepared.leaves
    for leaf in range(leaves):
        mine = prepared.corners[
            leaf * count // leaves : (leaf + 1) * count // leaves
        ].reshape(-1, 3)
        node = leaves + leaf
        while node:
            assert (prepared.boxes[node, :3] <= mine.min(axis=0)).all()
            assert (prepared.boxes[node, 3:] >= mine.max(axis=0)).all()
            node //= 2
    for k in range(3):
        across = prepared.corners[prepared.neighbours[:, k]]
        for corner in (prepared.corners[:, k], prepared.corners[:, (k + 1) % 3]):
            assert (
                np.abs(across - corner[:, None]).max(axis=2).min(axis=1) == 0.0
            ).all()


@pytest.mark.parametrize(
    ("data", "told"),
    [
        ({"kind": "sphere"}, "surface.radius: is missing"),
        (
            {"kind": "sphere", "radius": -1.0},
            "surface.radius: expected a number above 0, got -1.0",
        ),
        ({"kind": "box", "size": [0.1, 0.1]}, "surface.size"),
        (
            {"kind": "oriented_plane", "normal": [0.0, 0.0, 0.0]},
            r"surface.normal: \[0.0, 0.0, 0.0\] has no direction",
        ),
        (
            {"kind": "capsule", "start": [0.0] * 3, "end": [0.0] * 3, "radius": 0.01},
            "surface.end.*has no direction",
        ),
        (
            {
                "kind": "sphere",
                "radius": 0.1,
                "friction": {"static": 0.1, "dynamic": 0.2},
            },
            "dynamic is 0.2, expected at most",
        ),
        (
            {"kind": "union", "shapes": []},
            "surface.shapes: expected a list of length at least 1",
        ),
        (
            {"kind": "union", "shapes": [{"kind": "anchor"}]},
            r"surface.shapes\[0\].kind: 'anchor' is no shape",
        ),
        (
            {"kind": "union", "shapes": [{"kind": "sphere"}]},
            r"surface.shapes\[0\].radius: is missing",
        ),
        (
            {
                "kind": "union",
                "shapes": [{"kind": "sphere", "radius": 0.1, "tool_radius": 0.01}],
            },
            r"shapes\[0\].tool_radius",
        ),
        (
            {"kind": "mesh", "file": "nowhere.obj"},
            "surface.file: nowhere.obj cannot be read",
        ),
    ],
)
def test_a_surface_that_cannot_be_is_refused_by_its_path(
    data: dict[str, object], told: str
) -> None:
    with pytest.raises(ParameterError, match=told):
        parse_surface(data, "surface").check("surface")


@pytest.mark.parametrize("tool", [0.0, 1e-3])
@pytest.mark.parametrize("triangles", [CUBE, icosphere(1, 0.02)])
def test_a_device_on_a_corner_an_edge_or_a_face_is_met(
    triangles: Array, tool: float
) -> None:
    """Directly on the surface, and within rounding of a face along a step."""
    rng = np.random.default_rng(0)
    marks = np.concatenate(
        [
            triangles.reshape(-1, 3),
            triangles.mean(axis=1),
            0.5 * (triangles[:, 0] + triangles[:, 1]),
        ]
    )
    scales = np.array([1.0, 1.0, 1.0, 0.9, 1.2, 1.0 - 1e-10, 1.0 + 1e-10])
    path = marks[rng.integers(0, len(marks), 400)] * rng.choice(scales, 400)[:, None]
    path[::40] = (0.0, 0.0, 0.05)
    solids = [mesh(prepare_mesh(triangles, False, "file"))]
    found = touch(solids, path, tool, interpreted=True)
    assert np.isfinite(found.proxy).all()
    # Never inside: outside of every face of a convex body, in the plane of at least one.
    prepared = solids[0].mesh
    assert prepared is not None
    above = np.einsum(
        "tij,ij->ti",
        found.proxy[:, None] - prepared.corners[None, :, 0],
        prepared.normals,
    ).max(axis=1)
    assert above.min() > 0.0


@pytest.mark.slow
def test_a_launch_tells_what_was_repaired(tmp_path: Path) -> None:
    """On the terminal and in the recording: the felt mesh differs from the file."""
    ball = icosphere(2, 0.035)[:, ::-1]
    (tmp_path / "ball.stl").write_bytes(
        binary_stl(np.concatenate([ball, ball[:1, [0, 0, 1]]]))
    )
    (tmp_path / "given.yaml").write_text(
        f"environment: {{surface: {{kind: mesh, file: {tmp_path}/ball.stl}}}}",
        encoding="utf-8",
    )
    figures = launch_json(
        tmp_path,
        "sphere_feel",
        "pace:=lockstep",
        "duration:=0.1",
        "--params",
        "given.yaml",
    )
    told = " ".join(
        one.reason
        for one in Recording(tmp_path / figures["recording"]).messages(
            event("environment")
        )
        if one.kind == "mesh"
    )
    assert "1 triangles of fewer than three corners left out" in told
    assert "ball.stl: all faces pointed inwards and were flipped" in told
