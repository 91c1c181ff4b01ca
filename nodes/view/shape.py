"""Shape of a scene in 3D: triangles of its surface, sent once; poses come per frame."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from nodes.base.setup import AXIS_INDEX
from nodes.environment.shapes.kinds import Touchable
from nodes.environment.shapes.scene import Solid
from nodes.environment.shapes.tables import BOX, CAPSULE, CYLINDER, PLANE, SPHERE
from nodes.environment.surfaces import parse_surface

if TYPE_CHECKING:
    from nodes.environment.bodies.moving_scene import MovingScene

Points = NDArray[np.float64]

AROUND, ACROSS = (
    28,
    14,
)  # segments of a round shape around its axis, and from pole to pole
REACH = 0.08  # half side of the drawn part of an infinite plane [m]
_UP = np.array([0.0, 0.0, 1.0])
TRIANGLE_LIMIT = 20_000  # approximate limit of triangles sent; a finer mesh is thinned


def _grid(points: Points) -> Points:
    """Return the triangles of a grid of points, shape (m, n, 3), two per cell."""
    a, b, c, d = points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]
    return np.stack([a, b, c, a, c, d], axis=2).reshape(-1, 3, 3)


def _frame(axis: Points) -> tuple[Points, Points]:
    """Return two directions perpendicular to `axis` and each other."""
    first = np.cross(axis, (1.0, 0.0, 0.0) if abs(axis[0]) < 0.9 else (0.0, 1.0, 0.0))
    first /= np.linalg.norm(first)
    return first, np.cross(axis, first)


def _round(
    outline: Points, centre: Points, axis: Points, around: int = AROUND
) -> Points:
    """Return the triangles of a surface of revolution about `axis`.

    `outline` has rows of (position along the axis, distance from it) [m].
    """
    first, second = _frame(axis)
    turn = np.linspace(0.0, 2.0 * np.pi, around + 1)[:, None]
    circle = np.cos(turn) * first + np.sin(turn) * second
    return _grid(centre + outline[:, :1, None] * axis + outline[:, 1:, None] * circle)


def _plane(point: Points, normal: Points, reach: float = REACH) -> Points:
    first, second = _frame(normal)
    side = np.linspace(-reach, reach, 9)[:, None]
    return _grid(point + (side * first)[:, None] + side * second)


def _capsule(length: float, radius: float, across: int = ACROSS) -> Points:
    """Return the outline of a capsule that starts at its lower end's centre; length 0: a ball."""
    lower = np.linspace(0.0, 0.5 * np.pi, across // 2 + 1)
    upper = np.linspace(0.5 * np.pi, np.pi, across // 2 + 1)
    if length == 0.0:
        upper = upper[1:]  # one equator
    turn = np.concatenate([lower, upper])
    ends = np.repeat([0.0, length], [len(lower), len(upper)])
    return np.stack([ends - radius * np.cos(turn), radius * np.sin(turn)], axis=1)


def _cylinder(half: float, radius: float) -> Points:
    """Return the outline of a cylinder with its end discs."""
    return np.array([(-half, 0.0), (-half, radius), (half, radius), (half, 0.0)])


def _box(centre: Points, axes: Points, half: Points) -> Points:
    corners = (
        np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)])
        * half
        @ axes
        + centre
    )
    faces = (
        (0, 1, 3, 2),
        (4, 6, 7, 5),
        (0, 4, 5, 1),
        (2, 3, 7, 6),
        (0, 2, 6, 4),
        (1, 5, 7, 3),
    )
    return np.array(
        [
            corners[[a, b, c]]
            for f in faces
            for a, b, c in ((f[0], f[1], f[2]), (f[0], f[2], f[3]))
        ]
    )


def _triangles(solid: Solid) -> Points:
    n = np.array(solid.numbers)
    if solid.kind == PLANE:
        return _plane(n[:3], n[3:6])
    if solid.kind == SPHERE:
        return _round(_capsule(0.0, n[3]), n[:3], _UP)
    if solid.kind == CAPSULE:
        return _round(_capsule(n[6], n[7]), n[:3], n[3:6])
    if solid.kind == CYLINDER:
        return _round(_cylinder(n[6], n[7]), n[:3], n[3:6])
    if solid.kind == BOX:
        return _box(n[:3], n[3:12].reshape(3, 3), n[12:15])
    assert solid.mesh is not None  # noqa: S101  # what is left is a mesh
    corners = np.asarray(solid.mesh.corners)
    return corners[:: 1 + len(corners) // TRIANGLE_LIMIT]


def shape_of(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Return the shape of an environment's surface; empty if nothing is visible.

    ``triangles``: nine numbers per triangle [m].
    """
    surface = parse_surface(parameters.get("surface", {"kind": "free"}), "surface")
    if isinstance(surface, Touchable):
        found = [_triangles(solid) for solid in surface.solids("surface")]
        return {
            "triangles": np.round(np.concatenate(found).reshape(-1, 9), 6)
            .ravel()
            .tolist(),
            "tool_radius": surface.tool_radius,
            "friction": max(
                solid.friction.static for solid in surface.solids("surface")
            ),
        }
    axis, position = getattr(surface, "axis", None), getattr(surface, "position", None)
    if axis is None or position is None:
        return {}
    point, normal = np.zeros(3), np.zeros(3)
    point[AXIS_INDEX[axis]], normal[AXIS_INDEX[axis]] = (
        float(position),
        float(getattr(surface, "normal", 1.0)),
    )
    return {
        "triangles": np.round(_plane(point, normal), 6).ravel().tolist(),
        "tool_radius": 0.0,
        "friction": 0.0,
    }


def bodies_of(world: MovingScene) -> dict[str, Any]:
    """Return the triangles of each geom in its own frame [m]; poses come per frame."""
    import mujoco

    model = world.model
    found = []
    for i in range(model.ngeom):
        triangles = _geom(model, i, mujoco.mjtGeom)
        body = int(model.geom_bodyid[i])
        of_tool = int(model.body_rootid[body]) == world.tool
        flat = np.round(triangles.reshape(-1, 9), 6).ravel().tolist()
        found.append(
            {
                "name": model.geom(i).name or model.body(body).name,
                "tool": of_tool,
                "triangles": flat,
            }
        )
    return {"triangles": [], "bodies": found, "tool_radius": 0.0, "friction": 0.0}


def _geom(model: Any, i: int, kinds: Any) -> Points:
    """Return the triangles of a geom; empty for unsupported kinds."""
    kind, (a, b, c) = kinds(int(model.geom_type[i])), model.geom_size[i].tolist()
    centre = np.zeros(3)
    if kind == kinds.mjGEOM_PLANE:
        return _plane(centre, _UP, min(REACH, a or REACH))
    if kind == kinds.mjGEOM_SPHERE:
        return _round(_capsule(0.0, a, 8), centre, _UP, 16)
    if kind == kinds.mjGEOM_ELLIPSOID:
        return np.asarray(_round(_capsule(0.0, 1.0, 8), centre, _UP, 16) * [a, b, c])
    if kind == kinds.mjGEOM_CAPSULE:
        return _round(_capsule(2.0 * b, a, 9), np.array([0.0, 0.0, -b]), _UP, 16)
    if kind == kinds.mjGEOM_CYLINDER:
        return _round(_cylinder(b, a), centre, _UP, 20)
    if kind == kinds.mjGEOM_BOX:
        return _box(centre, np.eye(3), np.array([a, b, c]))
    if kind == kinds.mjGEOM_MESH:
        mesh = int(model.geom_dataid[i])
        first, count = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
        start = int(model.mesh_vertadr[mesh])
        faces = model.mesh_face[first : first + count : 1 + count // TRIANGLE_LIMIT]
        return np.asarray(model.mesh_vert[start + faces], dtype=np.float64)
    return np.zeros((0, 3, 3))
