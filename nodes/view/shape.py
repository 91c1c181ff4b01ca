"""What a scene looks like in three dimensions: triangles of its surface, sent once; what moves comes with every frame."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
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

AROUND, ACROSS = 28, 14
"""A round shape in parts around its axis, and from pole to pole."""

REACH = 0.08
"""A plane has no end; so much of it is drawn on each side [m]."""

_UP = np.array([0.0, 0.0, 1.0])

MOST = 20_000
"""Triangles that are sent: of a finer mesh, every so many-th."""


def _grid(at: Callable[[float, float], Points], around: int = AROUND, across: int = ACROSS) -> Points:
    """Triangles of a surface over two parameters from 0 to 1."""
    found = []
    for i in range(across):
        for j in range(around):
            a, b = i / across, (i + 1) / across
            c, d = j / around, (j + 1) / around
            found += [[at(a, c), at(b, c), at(b, d)], [at(a, c), at(b, d), at(a, d)]]
    return np.array(found)


def _frame(axis: Points) -> tuple[Points, Points]:
    """Two directions across another one."""
    first = np.cross(axis, (1.0, 0.0, 0.0) if abs(axis[0]) < 0.9 else (0.0, 1.0, 0.0))
    first /= np.linalg.norm(first)
    return first, np.cross(axis, first)


def _round(
    profile: Callable[[float], tuple[float, float]], centre: Points, axis: Points, around: int = AROUND, across: int = ACROSS
) -> Points:
    """Triangles of what is round about an axis: from 0 to 1, how far along it and how far from it [m]."""
    first, second = _frame(axis)

    def at(part: float, turn: float) -> Points:
        along, out = profile(part)
        angle = 2.0 * math.pi * turn
        return np.asarray(centre + along * axis + out * (math.cos(angle) * first + math.sin(angle) * second))

    return _grid(at, around, across)


def _plane(point: Points, normal: Points, reach: float = REACH) -> Points:
    first, second = _frame(normal)

    def at(a: float, b: float) -> Points:
        return np.asarray(point + reach * ((2.0 * a - 1.0) * first + (2.0 * b - 1.0) * second))

    return _grid(at, 8, 8)


def _sphere(radius: float) -> Callable[[float], tuple[float, float]]:
    return lambda part: (-radius * math.cos(math.pi * part), radius * math.sin(math.pi * part))


def _capsule(length: float, radius: float) -> Callable[[float], tuple[float, float]]:
    """Outline of a capsule that begins at the centre of its lower end."""

    def profile(part: float) -> tuple[float, float]:
        angle = math.pi * part
        return (length if part > 0.5 else 0.0) - radius * math.cos(angle), radius * math.sin(angle)

    return profile


def _cylinder(half: float, radius: float) -> Callable[[float], tuple[float, float]]:
    outline = ((-half, 0.0), (-half, radius), (half, radius), (half, 0.0))
    return lambda part: outline[min(3, int(part * 3.0 + 1e-9))]


def _box(centre: Points, axes: Points, half: Points) -> Points:
    corners = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)]) * half @ axes + centre
    faces = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    return np.array([corners[[a, b, c]] for f in faces for a, b, c in ((f[0], f[1], f[2]), (f[0], f[2], f[3]))])


def _triangles(solid: Solid) -> Points:
    n = np.array(solid.numbers)
    if solid.kind == PLANE:
        return _plane(n[:3], n[3:6])
    if solid.kind == SPHERE:
        return _round(_sphere(float(n[3])), n[:3], _UP)
    if solid.kind == CAPSULE:
        return _round(_capsule(float(n[6]), float(n[7])), n[:3], n[3:6])
    if solid.kind == CYLINDER:
        # Two discs and what is between them.
        return _round(_cylinder(float(n[6]), float(n[7])), n[:3], n[3:6], across=3)
    if solid.kind == BOX:
        return _box(n[:3], n[3:12].reshape(3, 3), n[12:15])
    assert solid.mesh is not None  # noqa: S101  # what is left is a mesh
    corners = np.asarray(solid.mesh.corners)
    return corners[:: 1 + len(corners) // MOST]


def shape_of(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Describe what an environment's surface looks like: triangles [m], nine numbers each; empty for nothing to see."""
    surface = parse_surface(parameters.get("surface", {"kind": "free"}), "surface")
    if isinstance(surface, Touchable):
        found = [_triangles(solid) for solid in surface.solids("surface")]
        return {
            "triangles": np.round(np.concatenate(found).reshape(-1, 9), 6).ravel().tolist(),
            "tool_radius": surface.tool_radius,
            "friction": max(solid.friction.static for solid in surface.solids("surface")),
        }
    axis, position = getattr(surface, "axis", None), getattr(surface, "position", None)
    if axis is None or position is None:
        return {}
    point, normal = np.zeros(3), np.zeros(3)
    point[AXIS_INDEX[axis]], normal[AXIS_INDEX[axis]] = float(position), float(getattr(surface, "normal", 1.0))
    return {"triangles": np.round(_plane(point, normal), 6).ravel().tolist(), "tool_radius": 0.0, "friction": 0.0}


def bodies_of(world: MovingScene) -> dict[str, Any]:
    """Describe a scene in which things move: triangles of each geom in its own frame [m]; its poses come later."""
    import mujoco

    model = world.model
    found = []
    for i in range(model.ngeom):
        triangles = _geom(model, i, mujoco.mjtGeom)
        body = int(model.geom_bodyid[i])
        of_tool = int(model.body_rootid[body]) == world.tool
        flat = np.round(triangles.reshape(-1, 9), 6).ravel().tolist()
        found.append({"name": model.geom(i).name or model.body(body).name, "tool": of_tool, "triangles": flat})
    return {"triangles": [], "bodies": found, "tool_radius": 0.0, "friction": 0.0}


def _geom(model: Any, i: int, kinds: Any) -> Points:
    """Triangles of a geom; none for a kind that has no outline of a few numbers."""
    kind, (a, b, c) = kinds(int(model.geom_type[i])), model.geom_size[i].tolist()
    centre = np.zeros(3)
    if kind == kinds.mjGEOM_PLANE:
        return _plane(centre, _UP, min(REACH, a or REACH))
    if kind == kinds.mjGEOM_SPHERE:
        return _round(_sphere(a), centre, _UP, 16, 8)
    if kind == kinds.mjGEOM_ELLIPSOID:
        return np.asarray(_round(_sphere(1.0), centre, _UP, 16, 8) * [a, b, c])
    if kind == kinds.mjGEOM_CAPSULE:
        return _round(_capsule(2.0 * b, a), np.array([0.0, 0.0, -b]), _UP, 16, 9)
    if kind == kinds.mjGEOM_CYLINDER:
        return _round(_cylinder(b, a), centre, _UP, 20, 3)
    if kind == kinds.mjGEOM_BOX:
        return _box(centre, np.eye(3), np.array([a, b, c]))
    if kind == kinds.mjGEOM_MESH:
        mesh = int(model.geom_dataid[i])
        first, count = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
        start = int(model.mesh_vertadr[mesh])
        faces = model.mesh_face[first : first + count : 1 + count // MOST]
        return np.asarray(model.mesh_vert[start + faces], dtype=np.float64)
    return np.zeros((0, 3, 3))
