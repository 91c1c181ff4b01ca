"""Repair of meshes against an independent inside test: libigl's winding number."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nodes.environment.shapes import mesh_shells
from nodes.environment.shapes import tables as t
from nodes.environment.shapes.mesh import prepare_mesh
from nodes.environment.shapes.mesh_file import read_mesh, read_triangles
from nodes.environment.shapes.mesh_repair import repair
from nodes.environment.shapes.mesh_report import write_mesh
from nodes.environment.shapes.mesh_shells import winding_number
from nodes.environment.shapes.polygons import cut_faces
from nodes.environment.shapes.proxy import meet
from nodes.environment.shapes.scene import mesh, new_memory, scene_table
from nodes.environment.shapes.tree import mesh_gap, mesh_winding
from nodes.environment.surfaces import parse_surface
from nodes.parameters.store import ParameterError
from sim.lab.proxy_shapes import icosphere
from tests.support import ROOT
from tests.support.shapes import Array, box_triangles, prism, turned, winding

CUBE = box_triangles((0.02, 0.02, 0.02))
FIXTURES = ROOT / "tests/fixtures/begin"


def written(corners: Array) -> str:
    """Return OBJ text with corners of their own for every triangle."""
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in corners.reshape(-1, 3).tolist()]
    return "\n".join(
        [
            *lines,
            *(f"f {3 * n + 1} {3 * n + 2} {3 * n + 3}" for n in range(len(corners))),
        ]
    )


def in_outline(outline: Array, places: Array) -> Any:
    """Whether places are inside an outline, by crossings of a ray."""
    inside = np.zeros(len(places), dtype=bool)
    for a, b in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        spans = (a[1] > places[:, 1]) != (b[1] > places[:, 1])
        with np.errstate(divide="ignore", invalid="ignore"):
            at = a[0] + (places[:, 1] - a[1]) / (b[1] - a[1]) * (b[0] - a[0])
        inside ^= spans & (places[:, 0] < at)
    return inside


def test_the_winding_number_is_that_of_libigl() -> None:
    places = np.random.default_rng(0).uniform(-0.03, 0.03, (200, 3))
    corners = np.concatenate([icosphere(2, 0.02), CUBE])
    assert (
        np.abs(winding_number(corners, places) - winding(corners, places)).max() < 1e-12
    )


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(4, 14))
def test_a_face_of_many_corners_is_cut_within_its_outline(
    seed: int, count: int
) -> None:
    """Star-shaped outlines, concave in general, with corners on straight edges too."""
    rng = np.random.default_rng(seed)
    angle = 2.0 * np.pi * (np.arange(count) + rng.uniform(0.0, 0.6, count)) / count
    outline = rng.uniform(0.005, 0.03, (count, 1)) * np.column_stack(
        [np.cos(angle), np.sin(angle)]
    )
    if seed % 2:
        outline = np.insert(outline, 1, 0.5 * (outline[0] + outline[1]), axis=0)
    points, groups = prism(outline, 0.02)
    corners = turned(points[cut_faces(points, groups)[0]], 0.3, -0.4, 0.5)
    prepared = prepare_mesh(corners, False, "file")
    places = rng.uniform((-0.03, -0.03, -0.01), (0.03, 0.03, 0.03), (150, 3))
    expected = (
        in_outline(outline, places) & (places[:, 2] > 0.0) & (places[:, 2] < 0.02)
    )
    found = winding(prepared.corners, turned(places[:, None], 0.3, -0.4, 0.5)[:, 0])
    assert np.abs(found - expected).max() < 1e-6
    # Nothing lies over a notch: the faces have the area of the prism, by the shoelace formula.
    following = np.roll(outline, -1, axis=0)
    cap = 0.5 * np.abs(
        (outline[:, 0] * following[:, 1] - outline[:, 1] * following[:, 0]).sum()
    )
    walls = 0.02 * np.linalg.norm(following - outline, axis=1).sum()
    edges = prepared.corners[:, 1:] - prepared.corners[:, :1]
    area = 0.5 * np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1).sum()
    assert area == pytest.approx(2.0 * cap + walls, rel=1e-6)


@pytest.mark.parametrize(
    ("triangles", "told"),
    [
        (np.concatenate([CUBE[:1, ::-1], CUBE[1:]]), "1 faces turned to agree"),
        (np.concatenate([CUBE, CUBE]), "12 repeated triangles left out"),
        (
            np.concatenate([CUBE, CUBE[:1], CUBE[:1, ::-1]]),
            "2 repeated triangles left out",
        ),
        (
            np.concatenate([CUBE, CUBE[:1] + 0.05, CUBE[:1, ::-1] + 0.05]),
            "2 triangles back to back with another left out",
        ),
        (
            np.concatenate([CUBE, CUBE[:, ::-1] + [0.05, 0.0, 0.0]]),
            "1 of 2 shells pointed inwards",
        ),
    ],
)
def test_each_repair_is_named(triangles: Array, told: str) -> None:
    prepared = prepare_mesh(triangles, False, "file")
    assert [told in text for text in prepared.repairs] == [True]
    places = np.random.default_rng(1).uniform(-0.02, 0.07, (200, 3))
    assert set(np.rint(winding(prepared.corners, places)).tolist()) <= {0.0, 1.0}


def test_two_cubes_that_share_an_edge_are_divided_by_angle() -> None:
    both = np.concatenate([CUBE, CUBE + np.array([0.02, 0.02, 0.0])])
    prepared = prepare_mesh(both, False, "file")
    assert prepared.repairs == (
        "file: 1 edges of more than two triangles divided by angle",
    )
    assert repair(both).closed.tolist() == [True, True]


def test_a_cavity_stays_one_in_a_file_turned_inside_out() -> None:
    hollow = np.concatenate([CUBE, 0.5 * CUBE[:, ::-1]])
    for triangles in (hollow, hollow[:, ::-1]):
        prepared = prepare_mesh(triangles, False, "file")
        places = np.array([[0.0, 0.0, 0.0], [0.0075, 0.0, 0.0], [0.015, 0.0, 0.0]])
        assert np.rint(winding(prepared.corners, places)).tolist() == [0.0, 1.0, 0.0]


def test_a_strip_of_one_side_is_no_solid_but_a_sheet() -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 25)
    rims = [
        np.column_stack(
            [
                (0.03 + s * np.cos(angle / 2)) * np.cos(angle),
                (0.03 + s * np.cos(angle / 2)) * np.sin(angle),
                s * np.sin(angle / 2),
            ]
        )
        for s in (-0.01, 0.01)
    ]
    a, b = rims
    strip = np.concatenate(
        [np.stack([a[:-1], a[1:], b[:-1]], 1), np.stack([b[:-1], a[1:], b[1:]], 1)]
    )
    with pytest.raises(
        ParameterError, match=r"one side only, as a Möbius strip.*sides: both"
    ):
        prepare_mesh(strip, False, "file")
    assert len(prepare_mesh(strip, True, "file").corners) == 2 * len(strip)


def test_more_shells_than_can_be_compared_are_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Only where some look inwards; others need no comparison."""
    monkeypatch.setattr(mesh_shells, "MOST_SHELLS", 2)
    three = np.concatenate([CUBE + np.array([0.03 * n, 0.0, 0.0]) for n in range(3)])
    assert prepare_mesh(three, False, "file").repairs == ()
    three[:12] = three[:12, ::-1]
    with pytest.raises(
        ParameterError, match=r"file: the mesh has 3 shells.*at most 2 can be"
    ):
        prepare_mesh(three, False, "file")


@pytest.mark.parametrize("name", ["u", "two_cubes_one_inverted", "bom"])
def test_files_of_others_are_felt_as_solids(name: str) -> None:
    """A concave face cut as a fan, a shell turned inwards, and a byte order mark."""
    read = read_mesh(FIXTURES / f"{name}.obj", "file")
    prepared = prepare_mesh(1e-3 * read.corners, False, "file", read.notes)
    # In the notch of u, in the second cube, in the cavity of bom; and a place in each solid.
    free, within = {
        "u": ([0.0, 0.0, 0.02], [0.0, -0.02, 0.02]),
        "two_cubes_one_inverted": ([0.05, 0.0, 0.0], [0.08, 0.0, 0.0]),
        "bom": ([0.0, 0.0, 0.0], [0.02, 0.0, 0.0]),
    }[name]
    found = winding(prepared.corners, np.array([free, within]))
    assert np.rint(found).tolist() == [0.0, 1.0]
    assert bool(prepared.repairs) == (name != "bom")


PLAIN = written(CUBE)
POINTS = CUBE.reshape(-1, 3)


def ply(order: str) -> bytes:
    head = (
        f"ply\nformat {order} 1.0\ncomment a cube\nelement vertex {len(POINTS)}\n"
        "property double x\nproperty double y\nproperty double z\nproperty uchar red\n"
        f"element face {len(CUBE)}\nproperty list uchar int vertex_indices\nend_header\n"
    ).encode()
    if order == "ascii":
        rows = [f"{x!r} {y!r} {z!r} 7" for x, y, z in POINTS.tolist()]
        rows += [f"3 {3 * n} {3 * n + 1} {3 * n + 2}" for n in range(len(CUBE))]
        return head + "\n".join(rows).encode()
    end = ">" if "big" in order else "<"
    points = np.zeros(len(POINTS), dtype=[("p", f"{end}f8", 3), ("red", "u1")])
    points["p"] = POINTS
    faces = np.zeros(len(CUBE), dtype=[("n", "u1"), ("v", f"{end}i4", 3)])
    faces["n"], faces["v"] = 3, np.arange(len(POINTS)).reshape(-1, 3)
    return head + points.tobytes() + faces.tobytes()


def off() -> str:
    points = "\n".join(f"{x!r} {y!r} {z!r}" for x, y, z in POINTS.tolist())
    faces = "\n".join(f"3 {3 * n} {3 * n + 1} {3 * n + 2}" for n in range(len(CUBE)))
    return f"OFF # a cube\n\n{len(POINTS)} {len(CUBE)} 0\n{points}\n{faces}\n"


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("bom.obj", b"\xef\xbb\xbf" + PLAIN.encode()),
        ("utf16.obj", PLAIN.encode("utf-16")),
        ("utf16_without_mark.obj", PLAIN.encode("utf-16-be")),
        ("continued.obj", PLAIN.replace("\nf 1 ", "\nf \\\r\n 1 ").encode()),
        ("dos.obj", PLAIN.replace("\n", "\r\n").encode()),
        (
            "faces_first.obj",
            "\n".join(sorted(PLAIN.splitlines(), key=lambda t: t[0])).encode(),
        ),
        ("ascii.ply", ply("ascii")),
        ("little.ply", ply("binary_little_endian")),
        ("big.PLY", ply("binary_big_endian")),
        ("cube.off", off().encode()),
    ],
)
def test_the_same_mesh_in_other_writings(
    name: str, data: bytes, tmp_path: Path
) -> None:
    (tmp_path / name).write_bytes(data)
    assert np.array_equal(read_triangles(tmp_path / name, "file"), CUBE)


@pytest.mark.parametrize("order", ["ascii", "binary_little_endian"])
def test_a_ply_cut_anywhere_is_refused(order: str, tmp_path: Path) -> None:
    whole = ply(order)
    for size in range(0, len(whole) - 4, 37):
        (tmp_path / "cut.ply").write_bytes(whole[:size])
        with pytest.raises(ParameterError, match=r"cut\.ply"):
            read_triangles(tmp_path / "cut.ply", "file")


@pytest.mark.parametrize(
    ("given", "width", "how"),
    [
        ({"unit": "mm"}, 0.1, "unit mm"),
        ({"unit": "inch"}, None, "100 units, unit inch"),
        ({"width": 0.08}, 0.08, "width 0.08 m"),
        ({"scale": 0.002}, 0.2, "scale 0.002"),
        ({}, None, "taken in metres"),
        ({"unit": "mm", "width": 0.08}, None, "unit and width each give the size"),
        ({"unit": "yard"}, None, "unit"),
    ],
)
def test_a_mesh_has_the_size_that_the_scene_says(
    given: dict[str, Any], width: float | None, how: str, tmp_path: Path
) -> None:
    """A box 100 units wide; nothing is converted that the launch file does not say."""
    file = tmp_path / "box.obj"
    write_mesh(
        file,
        box_triangles((100.0, 50.0, 20.0)).reshape(-1, 3),
        np.arange(36).reshape(-1, 3),
    )
    data = {"kind": "mesh", "file": str(file), **given}
    if width is None:
        with pytest.raises(ParameterError, match=how) as refused:
            parse_surface(data, "surface").check("surface")
        if not given:
            assert "unit: mm (0.1 m)" in str(refused.value)
        return
    numbers = parse_surface(data, "surface").numbers(1e-3)
    assert numbers is not None
    assert f"{1e3 * width:g} mm wide (100 units, {how})" in numbers.widths[0]
    table = np.array(numbers.table)
    at = int(table[t.ROWS + t.TRIANGLES])
    corners = table[at : at + 144].reshape(12, 12)[:, :9].reshape(-1, 3)
    assert np.ptp(corners, axis=0).max() == pytest.approx(width, rel=1e-15)


def test_a_tool_that_begins_in_overlapping_shells_is_inside() -> None:
    """Two balls that overlap, and one with a cavity: by the winding number, as libigl's."""
    ball = icosphere(2, 0.03)
    cavity = np.concatenate([icosphere(2, 0.06), 0.5 * icosphere(2, 0.06)[:, ::-1]])
    box = box_triangles((0.06, 0.06, 0.06))
    rng = np.random.default_rng(7)
    wrong_by_face = 0
    for triangles in (
        np.concatenate([ball, ball + np.array([0.02, 0.004, 0.0])]),
        cavity,
        np.concatenate([box, 0.5 * box + np.array([0.03, 0.0, 0.0])]),
    ):
        made = prepare_mesh(triangles, False, "file")
        table = scene_table([mesh(made)], 0.0, 1e-3)
        places = rng.uniform(-0.05, 0.05, (60, 3))
        # also where rays meet corners and edges
        places = np.concatenate(
            [places, rng.choice(made.corners.reshape(-1, 3), 10) * 0.9]
        )
        truth = np.rint(winding(made.corners, places)).astype(int)
        for place, inside in zip(places.tolist(), truth.tolist(), strict=True):
            assert mesh_winding(table, t.ROWS, *place) == inside
            memory = new_memory(1)
            face, _, _, _ = mesh_gap(
                table, t.ROWS, memory, t.LAST, t.LAST + 2, np.inf, *place
            )
            wrong_by_face += (face < 0.0) != (inside != 0)
            meet(table, memory, *place)
            if abs(face) > 1e-3:
                assert (memory[t.INSIDE] == 1.0) == (inside != 0)
    assert wrong_by_face > 0  # the nearest face alone does not tell
