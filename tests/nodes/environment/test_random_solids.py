"""Random damaged solids: repaired to what they were, and felt where they are.

The truth is libigl's winding number of the parts before they are damaged.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from nodes.environment.shapes import tables as t
from nodes.environment.shapes.mesh import PreparedMesh, _normals, prepare_mesh
from nodes.environment.shapes.polygons import cut_faces
from nodes.environment.shapes.proxy import meet
from nodes.environment.shapes.scene import mesh, new_memory, scene_table
from nodes.environment.shapes.touchable import TOOL_RADIUS
from sim.lab.proxy_shapes import icosphere
from tests.support.shapes import (
    Array,
    box_triangles,
    crossing_prism,
    prism,
    squared_distance,
    turned,
    winding,
)


def part(rng: np.random.Generator, size: float) -> Array:
    """Return a box, a ball, or a prism with star-shaped caps of many corners."""
    kind = rng.integers(0, 3)
    if kind == 0:
        return box_triangles([size] * 3)
    if kind == 1:
        return icosphere(2, 0.5 * size)
    count = int(rng.integers(5, 12))
    angle = 2.0 * np.pi * (np.arange(count) + rng.uniform(0.0, 0.6, count)) / count
    radius = size * rng.uniform(0.3, 0.7, (count, 1))
    outline = radius * np.column_stack([np.cos(angle), np.sin(angle)])
    points, groups = prism(outline, size)
    ids, _, _ = cut_faces(points, groups)
    return np.asarray(points[ids] - [0.0, 0.0, 0.5 * size])


def solid(rng: np.random.Generator) -> Array:
    """Return triangles of one to three parts: some hollow, some with a flush neighbour."""
    parts = []
    for n in range(int(rng.integers(1, 4))):
        size = float(rng.uniform(0.01, 0.02))
        made = part(rng, size)
        beside = rng.integers(0, 3)
        if beside == 1:  # a cavity
            made = np.concatenate([made, 0.4 * made[:, ::-1]])
        elif beside == 2:  # a seam: two boxes that share a face
            made = box_triangles([size] * 3)
            made = np.concatenate([made, made + np.array([size, 0.0, 0.0])])
        made = turned(made, *rng.uniform(-1.0, 1.0, 3).tolist())
        parts.append(made + np.array([0.06 * n, 0.0, 0.0]))
    return np.concatenate(parts)


def damaged(rng: np.random.Generator, corners: Array) -> Array:
    """Return the same solid with T-joints, copies, noise, and in single precision."""
    width = float(np.ptp(corners.reshape(-1, 3), axis=0).max())
    if rng.integers(0, 2):  # edges split on one side only: T-joints, also on seams
        split = rng.choice(len(corners), int(rng.integers(1, 9)), replace=False)
        share = 0.5 if rng.integers(0, 2) else rng.uniform(0.2, 0.8, (len(split), 1))
        a, b, c = np.moveaxis(corners[split], 1, 0)
        middle = a + share * (b - a)
        halves = [np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)]
        corners = np.concatenate([np.delete(corners, split, axis=0), *halves])
    if rng.integers(0, 2):  # a copy, a pair back to back, a triangle without area
        corners = np.concatenate([corners, corners[3:4], corners[5:7, [0, 0, 1]]])
    if rng.integers(0, 2):
        corners = corners[:, ::-1]
    corners = corners[rng.permutation(len(corners))]
    if rng.integers(0, 2):  # as in an STL file
        corners = corners.astype(np.float32).astype(np.float64)
    if rng.integers(0, 2):
        corners = corners + rng.uniform(-1e-7, 1e-7, corners.shape) * width
    return corners


def felt_inside(prepared: PreparedMesh, places: Array) -> list[bool]:
    """Whether a tool that begins at each place is in the mesh, or touches it."""
    table, found = scene_table([mesh(prepared)], TOOL_RADIUS, 1e-3), []
    for place in places.tolist():
        memory = new_memory(1)
        meet(table, memory, *place)
        found.append(memory[t.INSIDE] > 0.0 or memory[t.IN_CONTACT] == 1.0)
    return found


def near_faces(rng: np.random.Generator, corners: Array, count: int) -> Array:
    """Return places from 20 µm to 10 mm off faces, clear of all others by 20 µm."""
    chosen = corners[rng.integers(0, len(corners), count)]
    on = np.einsum("ij,ijk->ik", rng.dirichlet((1.0, 1.0, 1.0), count), chosen)
    way = rng.normal(size=(count, 3))
    off = np.exp(rng.uniform(np.log(2e-5), np.log(1e-2), (count, 1)))
    places = np.asarray(on + off * way / np.linalg.norm(way, axis=1)[:, None])
    return np.asarray(places[squared_distance(corners, places) > 4e-10])


@example(291)  # a T-joint beside a seam, of whose faces back to back none is left
@example(312)  # each side of a seam has a T-joint at the same place
@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_a_damaged_solid_is_felt_where_it_was(seed: int) -> None:
    """Faces of many corners, shells, cavities, seams, singles, noise, T-joints, copies."""
    rng = np.random.default_rng(seed)
    whole = solid(rng)
    prepared = prepare_mesh(damaged(rng, whole), False, "file")
    places = near_faces(rng, whole, 60)
    truth = np.rint(winding(whole, places)) != 0.0
    found = winding(prepared.corners, places)
    assert np.abs(found - np.rint(found)).max() < 1e-9  # closed
    assert ((np.rint(found) != 0.0) == truth).all()
    assert felt_inside(prepared, places[:10]) == truth[:10].tolist()
    # Neighbours share the edge, seen from both sides.
    for k in range(3):
        other = prepared.corners[prepared.neighbours[:, k]]
        for corner in (prepared.corners[:, k], prepared.corners[:, (k + 1) % 3]):
            assert (
                np.abs(other - corner[:, None]).max(axis=2).min(axis=1) == 0.0
            ).all()


@pytest.mark.parametrize("seed", range(6))
def test_turned_faces_do_not_open_a_solid(seed: int) -> None:
    """Without cavities: turned faces lose the file's own orientation of a cavity."""
    rng = np.random.default_rng(seed)
    whole = np.concatenate(
        [part(rng, 0.02), part(rng, 0.02) + np.array([0.06, 0.0, 0.0])]
    )
    flip = rng.random(len(whole)) < 0.2
    turned_some = np.where(flip[:, None, None], whole[:, ::-1], whole)
    prepared = prepare_mesh(turned_some, False, "file")
    places = near_faces(rng, whole, 100)
    assert (
        np.abs(winding(prepared.corners, places) - winding(whole, places)).max() < 1e-9
    )


def _curl() -> Array:
    """Return a prism whose outline laps over itself: within its inner loop it is solid twice."""
    angle = 2.0 * np.pi * (np.arange(24) + 0.5) / 24
    radius = 0.01 + 0.02 * np.cos(angle)
    outline = radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    return crossing_prism(outline, 0.02)


BOX = box_triangles([0.02] * 3)
OVERLAPPING = np.concatenate([BOX, BOX + np.array([0.015, 0.004, 0.0])])
CRACKED = np.concatenate([BOX, BOX + np.array([0.02 + 0.5 * TOOL_RADIUS, 0.001, 0.0])])


@pytest.mark.parametrize(
    ("corners", "lead"),
    [
        (OVERLAPPING, (0.005, 0.002, 0.0)),
        (CRACKED, (0.01, 0.0, 0.0)),
        (_curl(), (0.005, 0.0, 0.01)),
    ],
    ids=["overlapping", "cracked", "curl"],
)
def test_a_tool_begins_where_the_winding_number_says(
    corners: Array, lead: tuple[float, float, float]
) -> None:
    """Behind hidden faces, in a crack that the tool does not fit into, at crossings."""
    prepared = prepare_mesh(corners, False, "file")
    rng = np.random.default_rng(0)
    places = np.concatenate(
        [near_faces(rng, prepared.corners, 60), rng.normal(lead, 5e-4, (20, 3))]
    )
    places = places[np.abs(winding(prepared.corners, places)) > -1.0]
    places = places[squared_distance(corners, places) > 4e-10]
    truth = np.rint(winding(prepared.corners, places)) != 0.0
    assert 0 < truth.sum() < len(truth)
    assert felt_inside(prepared, places) == truth.tolist()


def test_a_flat_triangle_that_a_repair_left_has_its_neighbours_normal() -> None:
    """A zero in its length made the normal, and then the force, no number."""
    corners = box_triangles([0.02] * 3)
    middle = 0.5 * (corners[0, 0] + corners[0, 1])
    flat = np.array([[corners[0, 0], corners[0, 1], middle]])
    with np.errstate(all="raise"):
        found = _normals(
            np.concatenate([corners, flat]),
            np.concatenate([np.zeros((12, 3), dtype=np.int64), [[0, -1, -1]]]),
        )
    assert np.abs(np.linalg.norm(found, axis=1) - 1.0).max() < 1e-12
    assert np.array_equal(found[12], found[0])
