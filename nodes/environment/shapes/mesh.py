"""Preparing a mesh for contact: checks, safe repairs, and its bounding-volume tree."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nodes.environment.shapes.tables import NODE
from nodes.parameters.store import ParameterError

Corners = NDArray[np.float64]  # triangles, corners, coordinates [m], shape (n, 3, 3)
LARGEST = 2.0  # largest extent of a mesh [m]; a larger one was probably drawn in millimetres
SMALLEST = 1e-3

_LEAF = 4  # largest number of triangles in a leaf of the tree
_SLIVER = 1e-9  # height below which a triangle is degenerate [m]


class PreparedMesh(NamedTuple):
    """A mesh as the geometry uses it."""

    corners: Corners  # triangles in the order of the tree [m], shape (n, 3, 3)
    normals: NDArray[np.float64]  # outward normals, shape (n, 3)
    neighbours: NDArray[np.int64]  # triangle across each edge, −1 for none, shape (n, 3)
    # bounding boxes in heap order, root at 1: lower, upper corner [m], shape (2 * leaves, 6)
    boxes: NDArray[np.float64]
    leaves: int  # leaves of the tree
    closed: bool  # whether it bounds a solid
    repairs: tuple[str, ...]  # what was repaired, as text


def prepare_mesh(corners: Corners, both_sides: bool, where: str) -> PreparedMesh:
    """Check triangles [m], shape (n, 3, 3), and return them with neighbours and tree.

    Raises ParameterError if the triangles bound no solid (or form no sheet, with `both_sides`).
    """
    repairs = []
    if not np.isfinite(corners).all():
        bad = int(np.flatnonzero(~np.isfinite(corners).all(axis=(1, 2)))[0])
        raise ParameterError(f"{where}: triangle {bad} has a coordinate that is not finite")
    extent = float(np.ptp(corners.reshape(-1, 3), axis=0).max())
    if not SMALLEST <= extent <= LARGEST:
        small = "its scale is too small, or its unit is not m"
        hint = "a file in millimetres takes scale: 0.001" if extent > LARGEST else small
        raise ParameterError(
            f"{where}: the mesh is {extent:.4g} m wide, expected {SMALLEST:g} to {LARGEST:g} m;"
            f" {hint}"
        )
    # Corners at the same place are merged: STL repeats them per triangle, in single precision.
    corner, ids = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    ids = ids.reshape(-1, 3).astype(np.int64)
    corners = corner[ids]
    good = (ids[:, 0] != ids[:, 1]) & (ids[:, 1] != ids[:, 2]) & (ids[:, 2] != ids[:, 0])
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    twice_area = np.linalg.norm(across, axis=1)
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    flat = good & (twice_area <= _SLIVER * longest)
    if flat.any():
        raise ParameterError(
            f"{where}: triangle {int(np.flatnonzero(flat)[0])} is flat: its corners lie on a line"
            f" ({int(flat.sum())} such); clean the mesh"
        )
    if not good.all():
        repairs.append(
            f"{where}: {int((~good).sum())} triangles of fewer than three corners left out"
        )
    corners, ids, across, twice_area = corners[good], ids[good], across[good], twice_area[good]
    if not len(corners):
        raise ParameterError(f"{where}: no triangle has an area")
    if both_sides:
        corners = np.concatenate([corners, corners[:, ::-1]])
        # Separate corners for the back, so that no triangle is its own neighbour.
        ids = np.concatenate([ids, ids[:, ::-1] + len(corner)])
        normals = (
            np.concatenate([across, -across]) / np.concatenate([twice_area, twice_area])[:, None]
        )
    else:
        _refuse_open(ids, where)
        normals = across / twice_area[:, None]
        if float(np.einsum("ij,ij->", corners[:, 0] - corner[0], across)) < 0.0:
            corners, ids, normals = corners[:, ::-1], ids[:, ::-1], -normals
            repairs.append(f"{where}: all faces pointed inwards and were flipped")
    order, leaves = _order(corners)
    corners, ids, normals = corners[order], ids[order], normals[order]
    boxes = _boxes(corners, leaves)
    return PreparedMesh(
        np.ascontiguousarray(corners),
        normals,
        _neighbours(ids),
        boxes,
        leaves,
        not both_sides,
        tuple(repairs),
    )


def _edges(ids: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return a number for each directed edge, unique to its two corners."""
    return np.asarray(ids * (int(ids.max()) + 1) + np.roll(ids, -1, axis=1), dtype=np.int64)


def _refuse_open(ids: NDArray[np.int64], where: str) -> None:
    there = _edges(ids).ravel()
    back = _edges(ids[:, ::-1]).ravel()
    named, times = np.unique(there, return_counts=True)
    undirected = np.minimum(ids, np.roll(ids, -1, axis=1)) * (int(ids.max()) + 1) + np.maximum(
        ids, np.roll(ids, -1, axis=1)
    )
    _, shared = np.unique(undirected, return_counts=True)
    if lonely := int((shared == 1).sum()):
        raise ParameterError(
            f"{where}: the mesh is open: {lonely} edges have one triangle only, so it has no"
            " inside; close it, or set sides: both to feel it as a sheet"
        )
    if many := int((shared > 2).sum()):
        raise ParameterError(
            f"{where}: {many} edges have more than two triangles; split the mesh into solids"
        )
    if (times > 1).any() or not np.array_equal(np.sort(named), np.unique(back)):
        raise ParameterError(
            f"{where}: faces disagree about where outside is: {int((times > 1).sum())} edges are"
            " passed twice in one direction; orient the faces alike"
        )


def _neighbours(ids: NDArray[np.int64]) -> NDArray[np.int64]:
    there = _edges(ids).ravel()
    second = np.roll(ids, -1, axis=1) * (int(ids.max()) + 1) + ids
    order = np.argsort(there, kind="stable")
    at = np.searchsorted(there[order], second.ravel())
    at = np.minimum(at, len(there) - 1)
    found = there[order][at] == second.ravel()
    return np.where(found, order[at] // 3, -1).reshape(-1, 3)


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
        mine = np.repeat(np.arange(parts), np.diff(bounds))
        low = np.minimum.reduceat(centres[order], bounds[:-1])
        high = np.maximum.reduceat(centres[order], bounds[:-1])
        axis = np.argmax(high - low, axis=1)
        order = order[np.lexsort((centres[order, axis[mine]], mine))]
        parts *= 2
    return order, leaves


def _boxes(corners: Corners, leaves: int) -> NDArray[np.float64]:
    boxes = np.empty((2 * leaves, NODE))
    bounds = np.arange(leaves + 1) * len(corners) // leaves
    boxes[leaves:, :3] = np.minimum.reduceat(corners.min(axis=1), bounds[:-1])
    boxes[leaves:, 3:] = np.maximum.reduceat(corners.max(axis=1), bounds[:-1])
    first = leaves // 2
    while first:
        left, right = boxes[2 * first : 4 * first : 2], boxes[2 * first + 1 : 4 * first : 2]
        boxes[first : 2 * first, :3] = np.minimum(left[:, :3], right[:, :3])
        boxes[first : 2 * first, 3:] = np.maximum(left[:, 3:], right[:, 3:])
        first //= 2
    boxes[0] = 0.0
    return boxes
