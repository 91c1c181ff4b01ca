"""Triangles of the shapes and geoms that a page draws; round ones share corners."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nodes.environment.shapes.polygons import Ids
from nodes.environment.shapes.scene import Solid
from nodes.environment.shapes.tables import BOX, CAPSULE, CYLINDER, PLANE, SPHERE

Points = NDArray[np.float64]

AROUND, ACROSS = (
    48,
    24,
)  # segments of a round shape around its axis, and from pole to pole
REACH = 0.08  # half side of the drawn part of an infinite plane [m]
_UP: Final = np.array([0.0, 0.0, 1.0])
_SAME = 9  # decimals to which corners of one round surface are equal [m]


class Patch(NamedTuple):
    """Triangles of a shape; a shared corner has one normal, unless it is `flat`."""

    points: Points  # corners [m], shape (n, 3)
    faces: Ids  # three corners of each triangle, outward, shape (m, 3)
    flat: bool = False  # whether each triangle has its own normal
    closed: bool = False  # whether its inside is never seen

    @property
    def corners(self) -> Points:
        """Corners of each triangle [m], shape (m, 3, 3)."""
        return self.points[self.faces]


def _joined(patches: Sequence[Patch]) -> Patch:
    """Return patches as a closed one; where they meet there is an edge."""
    starts = np.cumsum([0, *(len(patch.points) for patch in patches)])
    faces = [patch.faces + start for patch, start in zip(patches, starts, strict=False)]
    points = np.concatenate([patch.points for patch in patches])
    return Patch(points, np.concatenate(faces), closed=True)


def _grid(points: Points) -> Patch:
    """Return the triangles of a grid of points, shape (m, n, 3), without those of no area."""
    rows, columns = points.shape[:2]
    number = np.arange(rows * columns).reshape(rows, columns)
    a = number[:-1, :-1]
    b = number[1:, :-1]
    c = number[1:, 1:]
    d = number[:-1, 1:]
    faces = np.stack([a, b, c, a, c, d], axis=2).reshape(-1, 3)
    rounded = np.round(points.reshape(-1, 3), _SAME) + 0.0
    _, first, which = np.unique(rounded, axis=0, return_index=True, return_inverse=True)
    faces = which.reshape(-1)[faces]
    kept = (faces != np.roll(faces, -1, axis=1)).all(axis=1)
    return Patch(points.reshape(-1, 3)[first], faces[kept])


def _frame(axis: Points) -> tuple[Points, Points]:
    """Return two directions perpendicular to `axis` and each other."""
    first = np.cross(axis, (1.0, 0.0, 0.0) if abs(axis[0]) < 0.9 else (0.0, 1.0, 0.0))
    first /= np.linalg.norm(first)
    return first, np.cross(axis, first)


def _round(
    outlines: Sequence[Points], centre: Points, axis: Points, around: int = AROUND
) -> Patch:
    """Return the triangles of a surface of revolution about `axis`.

    Each outline has rows of (position along the axis, distance from it) [m]; between two outlines
    there is an edge.
    """
    first, second = _frame(axis)
    turn = np.linspace(0.0, 2.0 * np.pi, around + 1)[:, None]
    circle = np.cos(turn) * first + np.sin(turn) * second
    return _joined(
        [
            # around before along, so that all triangles face outward
            _grid(
                np.swapaxes(
                    centre + line[:, :1, None] * axis + line[:, 1:, None] * circle, 0, 1
                )
            )
            for line in outlines
        ]
    )


def plane_patch(point: Points, normal: Points, reach: float = REACH) -> Patch:
    """Return a square of a plane."""
    first, second = _frame(normal)
    side = np.linspace(-reach, reach, 9)[:, None]
    return _grid(point + (side * first)[:, None] + side * second)


def _capsule(length: float, radius: float, across: int = ACROSS) -> list[Points]:
    """Return the outline of a capsule that starts at its lower end's centre; length 0: a ball."""
    lower = np.linspace(0.0, 0.5 * np.pi, across // 2 + 1)
    upper = np.linspace(0.5 * np.pi, np.pi, across // 2 + 1)
    if length == 0.0:
        upper = upper[1:]  # one equator
    turn = np.concatenate([lower, upper])
    ends = np.repeat([0.0, length], [len(lower), len(upper)])
    away = radius * np.sin(turn)
    away[[0, -1]] = 0.0  # both poles lie on the axis
    return [np.stack([ends - radius * np.cos(turn), away], axis=1)]


def _cylinder(half: float, radius: float) -> list[Points]:
    """Return the outlines of a cylinder: its end discs and its side."""
    rows = np.array([(-half, 0.0), (-half, radius), (half, radius), (half, 0.0)])
    return [rows[:2], rows[1:3], rows[2:]]


def _box(centre: Points, axes: Points, half: Points) -> Patch:
    signs = np.array(list(itertools.product((-1, 1), repeat=3)))
    corners = signs * half @ axes + centre
    quads = [
        (0, 1, 3, 2),
        (4, 6, 7, 5),
        (0, 4, 5, 1),
        (2, 3, 7, 6),
        (0, 2, 6, 4),
        (1, 5, 7, 3),
    ]
    points = corners[np.array(quads)].reshape(-1, 3)
    halves = np.array([[0, 1, 2], [0, 2, 3]])
    faces = 4 * np.arange(6)[:, None, None] + halves
    return Patch(points, faces.reshape(-1, 3), closed=True)


def _mesh(corners: Points) -> Patch:
    """Return the triangles of a mesh, corners shape (m, 3, 3), with shared corners."""
    from nodes.environment.shapes.mesh_edges import first_of_equal

    points = corners.reshape(-1, 3)
    first, which = first_of_equal(points)
    return Patch(points[first], which.reshape(-1, 3), flat=True, closed=True)


def patch_of(solid: Solid) -> Patch:
    """Return the triangles of a solid that is touched."""
    n = np.array(solid.numbers)
    if solid.kind == PLANE:
        return plane_patch(n[:3], n[3:6])
    if solid.kind == SPHERE:
        return _round(_capsule(0.0, n[3]), n[:3], _UP)
    if solid.kind == CAPSULE:
        return _round(_capsule(n[6], n[7]), n[:3], n[3:6])
    if solid.kind == CYLINDER:
        return _round(_cylinder(n[6], n[7]), n[:3], n[3:6])
    if solid.kind == BOX:
        return _box(n[:3], n[3:12].reshape(3, 3), n[12:15])
    assert solid.mesh is not None  # noqa: S101  # what is left is a mesh
    return _mesh(np.asarray(solid.mesh.corners))


def geom_patch(model: Any, i: int, kinds: Any) -> Patch | None:
    """Return the triangles of a MuJoCo geom in its own frame; None for other kinds."""
    kind = kinds(int(model.geom_type[i]))
    (a, b, c) = model.geom_size[i].tolist()
    centre = np.zeros(3)
    if kind == kinds.mjGEOM_PLANE:
        # the engine's plane is infinite; its size is how much of it is drawn
        return plane_patch(centre, _UP, min(2.0 * REACH, a or 2.0 * REACH))
    if kind == kinds.mjGEOM_SPHERE:
        return _round(_capsule(0.0, a), centre, _UP)
    if kind == kinds.mjGEOM_ELLIPSOID:
        ball = _round(_capsule(0.0, 1.0), centre, _UP)
        return ball._replace(points=ball.points * [a, b, c])
    if kind == kinds.mjGEOM_CAPSULE:
        return _round(_capsule(2.0 * b, a), np.array([0.0, 0.0, -b]), _UP)
    if kind == kinds.mjGEOM_CYLINDER:
        return _round(_cylinder(b, a), centre, _UP)
    if kind == kinds.mjGEOM_BOX:
        return _box(centre, np.eye(3), np.array([a, b, c]))
    if kind == kinds.mjGEOM_MESH:
        mesh = int(model.geom_dataid[i])
        first = int(model.mesh_faceadr[mesh])
        count = int(model.mesh_facenum[mesh])
        start = int(model.mesh_vertadr[mesh])
        points = int(model.mesh_vertnum[mesh])
        return Patch(
            np.asarray(model.mesh_vert[start : start + points], dtype=np.float64),
            np.asarray(model.mesh_face[first : first + count], dtype=np.int64),
            flat=True,
        )
    if kind == kinds.mjGEOM_HFIELD:
        return _heights(model, int(model.geom_dataid[i]))
    return None


def _heights(model: Any, i: int) -> Patch:
    """Return the upper surface of a height field."""
    rows = int(model.hfield_nrow[i])
    columns = int(model.hfield_ncol[i])
    width, depth, height, _ = model.hfield_size[i].tolist()
    first = int(model.hfield_adr[i])
    data = np.asarray(model.hfield_data[first : first + rows * columns], dtype=float)
    y, x = np.meshgrid(
        np.linspace(-depth, depth, rows),
        np.linspace(-width, width, columns),
        indexing="ij",
    )
    up = height * data.reshape(rows, columns)
    return _grid(np.swapaxes(np.stack([x, y, up], axis=2), 0, 1))
