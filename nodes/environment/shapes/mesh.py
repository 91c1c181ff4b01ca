"""Preparing a mesh for contact: checks, safe repairs, and its bounding-volume tree."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nodes.environment.shapes.mesh_edges import rims
from nodes.environment.shapes.mesh_holes import holes
from nodes.environment.shapes.mesh_lobes import inside_out
from nodes.environment.shapes.mesh_repair import NARROW, SLIVER, Repaired, repair
from nodes.environment.shapes.tables import NODE
from nodes.environment.shapes.triangle_sets import lowest_heights
from nodes.parameters.store import ParameterError

Corners = NDArray[np.float64]  # triangles, corners, coordinates [m], shape (n, 3, 3)
# largest extent of a mesh [m]; a larger one was probably drawn in millimetres
LARGEST = 2.0
SMALLEST = 1e-3

_FLAT_ROUNDS = 20  # steps from a flat triangle to one that has a normal
_LEAF = 4  # largest number of triangles in a leaf of the tree


class PreparedMesh(NamedTuple):
    """A mesh as the geometry uses it."""

    corners: Corners  # triangles in the order of the tree [m], shape (n, 3, 3)
    normals: NDArray[np.float64]  # outward normals, shape (n, 3)
    # triangle across each edge, −1 for none, shape (n, 3)
    neighbours: NDArray[np.int64]
    # bounding boxes in heap order, root at 1: lower, upper corner [m], shape (2 * leaves, 6)
    boxes: NDArray[np.float64]
    leaves: int  # leaves of the tree
    closed: bool  # whether it bounds a solid
    repairs: tuple[str, ...]  # what was repaired, as text
    width: str = ""  # how wide it is, and by which unit, as text


def prepare_mesh(
    corners: Corners, both_sides: bool, where: str, notes: tuple[str, ...] = ()
) -> PreparedMesh:
    """Repair triangles [m], shape (n, 3, 3), and return them with neighbours and tree.

    `notes` are reported before the repairs: what was read otherwise than it stands in the file.
    Raises ParameterError if the triangles bound no solid (or form no sheet, with `both_sides`).
    """
    found = repaired_triangles(corners, where)
    if not both_sides:
        refuse_no_solid(found, where, notes)
    ids = found.ids
    neighbours = found.partner.reshape(-1, 3) // 3
    if both_sides:
        # Separate corners for the back, so that no triangle is its own neighbour.
        ids = np.concatenate([ids, ids[:, ::-1]])
        back = np.where(neighbours < 0, -1, neighbours + len(found.ids))[:, [1, 0, 2]]
        neighbours = np.concatenate([neighbours, back])
    corners = found.points[ids]
    normals = _normals(corners, neighbours)
    order, leaves = _order(corners)
    corners, normals, neighbours = corners[order], normals[order], neighbours[order]
    place = np.append(np.argsort(order), -1)  # the last one is of a neighbour −1
    boxes = _boxes(corners, leaves)
    return PreparedMesh(
        np.ascontiguousarray(corners),
        normals,
        place[neighbours],
        boxes,
        leaves,
        not both_sides,
        tuple(f"{where}: {text}" for text in (*notes, *found.texts())),
    )


def _normals(corners: Corners, neighbours: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return outward normals; a flat triangle that a repair left has a neighbour's."""
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = across / np.maximum(np.linalg.norm(across, axis=1), 1e-300)[:, None]
    flat = lowest_heights(corners)[0] <= SLIVER
    for _ in range(_FLAT_ROUNDS):
        left = np.flatnonzero(flat)
        if not len(left):
            break
        beside = neighbours[left]
        whole = (beside >= 0) & ~flat[beside]
        solved = whole.any(axis=1)
        chosen = beside[np.arange(len(left)), whole.argmax(axis=1)]
        normals[left[solved]] = normals[chosen[solved]]
        flat[left[solved]] = False
        if not solved.any():
            break
    return np.asarray(normals)


def repaired_triangles(corners: Corners, where: str) -> Repaired:
    """Check the coordinates and the width of triangles [m], shape (n, 3, 3), and repair them.

    Raises ParameterError if no sheet can be made of them.
    """
    if not np.isfinite(corners).all():
        bad = int(np.flatnonzero(~np.isfinite(corners).all(axis=(1, 2)))[0])
        raise ParameterError(
            f"triangle {bad} has a coordinate that is not finite", path=where
        )
    extent = float(np.ptp(corners.reshape(-1, 3), axis=0).max())
    if not SMALLEST <= extent <= LARGEST:
        small = "its scale is too small, or its unit is not m"
        hint = "a file in millimetres takes scale: 0.001" if extent > LARGEST else small
        raise ParameterError(
            f"the mesh is {extent:.4g} m wide, expected {SMALLEST:g} to {LARGEST:g} m; {hint}",
            path=where,
        )
    # Corners at the same place are merged: STL repeats them per triangle, in single precision.
    try:
        found = repair(corners)
    except ValueError as error:
        raise ParameterError(f"the mesh {error}", path=where) from error
    if not len(found.ids):
        raise ParameterError("no triangle has an area", path=where)
    return found


def refuse_no_solid(found: Repaired, where: str, notes: tuple[str, ...]) -> None:
    """Raise ParameterError unless a mesh bounds a solid; name the reason and the ways out."""
    if found.is_solid:
        _refuse_inside_out(found, where)
        return
    lonely = int((found.partner < 0).sum())
    if found.disagreeing:
        raise ParameterError(
            f"{found.disagreeing} surfaces have one side only, as a Möbius strip: their"
            " faces disagree about where outside is; set sides: both to feel the mesh as a sheet",
            path=where,
        )
    rim = holes(found.points, found.ids, rims(found.partner))
    error = ParameterError(
        f"the mesh is open: {lonely} edges have one triangle only, so it has no inside"
        f" ({len(rim)} holes, the largest of {rim[0].edges} edges, {rim[0].width:.3g} m wide);"
        " close it (haptic mesh FILE --close OUT fills small holes), or set sides: both to feel it"
        " as a sheet",
        path=where,
    )
    raise error.continued("".join(f"; {note}" for note in notes))


def _refuse_inside_out(found: Repaired, where: str) -> None:
    lobe = inside_out(found.points[found.ids])
    if lobe is None or lobe.length <= NARROW:
        return
    x, y, z = lobe.place
    raise ParameterError(
        f"a part of the mesh is inside out, {lobe.length:.2g} m long at"
        f" ({x:.4g}, {y:.4g}, {z:.4g}) m: the mesh crosses itself, and a tool would be caught"
        " there; unite its parts in the program that made it, or set sides: both to feel it as a"
        " sheet",
        path=where,
    )


def _order(corners: Corners) -> tuple[NDArray[np.int64], int]:
    """Sort triangles into the leaves of a complete tree, halving along the longest side."""
    count = len(corners)
    leaves = 1
    while leaves * _LEAF < count:
        leaves *= 2
    centres = corners.mean(axis=1)
    order = np.arange(count)
    parts = 1
    while parts < leaves:
        bounds = np.arange(parts + 1) * count // parts
        low = np.minimum.reduceat(centres[order], bounds[:-1])
        high = np.maximum.reduceat(centres[order], bounds[:-1])
        axis = np.argmax(high - low, axis=1)
        # Each part is a row, and sorted by itself; parts differ by one triangle at most.
        begins = bounds[:-1, None]
        sizes = np.diff(bounds)[:, None]
        columns = np.arange(sizes.max())
        own = columns < sizes
        places = centres[order[np.minimum(begins + columns, count - 1)], axis[:, None]]
        ranks = np.argsort(np.where(own, places, np.inf), axis=1, kind="stable")
        order = order[(begins + ranks)[own]]
        parts *= 2
    return order, leaves


def _boxes(corners: Corners, leaves: int) -> NDArray[np.float64]:
    boxes = np.empty((2 * leaves, NODE))
    bounds = np.arange(leaves + 1) * len(corners) // leaves
    boxes[leaves:, :3] = np.minimum.reduceat(corners.min(axis=1), bounds[:-1])
    boxes[leaves:, 3:] = np.maximum.reduceat(corners.max(axis=1), bounds[:-1])
    first = leaves // 2
    while first:
        left = boxes[2 * first : 4 * first : 2]
        right = boxes[2 * first + 1 : 4 * first : 2]
        boxes[first : 2 * first, :3] = np.minimum(left[:, :3], right[:, :3])
        boxes[first : 2 * first, 3:] = np.maximum(left[:, 3:], right[:, 3:])
        first //= 2
    boxes[0] = 0.0
    return boxes
