"""Shapes, paths and independent oracles of the proxy: textbook distances, least squares."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from nodes.environment.shapes.scene import Solid, rotation
from nodes.environment.shapes.tables import BOX, CAPSULE, CYLINDER, MESH, PLANE, SPHERE
from sim.lab.proxy_shapes import nearest_on

Array = NDArray[np.float64]


def box_triangles(size: Any) -> Array:
    """Return the twelve triangles of a box about the origin, shape (12, 3, 3)."""
    corners = (
        np.array(
            [[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]
        )
        * size
    )
    quads = [
        (0, 1, 3, 2),
        (4, 6, 7, 5),
        (0, 4, 5, 1),
        (2, 3, 7, 6),
        (0, 2, 6, 4),
        (1, 5, 7, 3),
    ]
    return np.asarray(
        corners[[face for a, b, c, d in quads for face in ([a, b, c], [a, c, d])]],
        dtype=np.float64,
    )


def wander(
    rng: np.random.Generator, ticks: int, step: float, limits: Any, start: Any
) -> Array:
    """Return random steps of limited length, folded back into a box, shape (ticks, 3)."""
    way = rng.normal(size=(ticks, 3))
    way *= rng.uniform(0.0, step, (ticks, 1)) / np.linalg.norm(
        way, axis=1, keepdims=True
    )
    limits = np.asarray(limits, dtype=np.float64)
    far = np.cumsum(way, axis=0) + start + limits
    return np.asarray(
        np.abs((far + 2.0 * limits) % (4.0 * limits) - 2.0 * limits) - limits,
        dtype=np.float64,
    )


def distance_to(solid: Solid, point: Array) -> float:
    """Return the signed textbook distance [m]; for meshes unsigned, by brute force."""
    given = np.array(solid.numbers)
    if solid.kind == PLANE:
        return float((point - given[:3]) @ given[3:])
    if solid.kind == SPHERE:
        return float(np.linalg.norm(point - given[:3]) - given[3])
    if solid.kind == CAPSULE:
        along = np.clip((point - given[:3]) @ given[3:6], 0.0, given[6])
        return float(np.linalg.norm(point - given[:3] - along * given[3:6]) - given[7])
    if solid.kind == CYLINDER:
        along = (point - given[:3]) @ given[3:6]
        across = np.linalg.norm(point - given[:3] - along * given[3:6])
        over = np.array([across - given[7], abs(along) - given[6]])
        return float(np.linalg.norm(np.maximum(over, 0.0)) + min(over.max(), 0.0))
    if solid.kind == BOX:
        over = np.abs(given[3:12].reshape(3, 3) @ (point - given[:3])) - given[12:15]
        return float(np.linalg.norm(np.maximum(over, 0.0)) + min(over.max(), 0.0))
    assert solid.kind == MESH
    assert solid.mesh is not None
    return float(
        np.linalg.norm(point - nearest_on(solid.mesh.corners, point), axis=1).min()
    )


def out_of_balance(
    solids: list[Solid], radius: float, proxy: Array, device: Array
) -> float:
    """Return the distance of a proxy from frictionless equilibrium [m].

    That is its deflection minus the nearest sum of pushes along the gradients of the distances of
    touched solids, by central differences: nothing under test is used.
    """
    step = 1e-6
    pushes = []
    for solid in solids:
        if solid.kind == MESH:
            assert solid.mesh is not None
            corners, normals = solid.mesh.corners, solid.mesh.normals
            nearest = nearest_on(corners, proxy)
            away = np.linalg.norm(proxy - nearest, axis=1)
            for i in np.flatnonzero(away <= radius + 1e-8):
                flat = abs((proxy - corners[i, 0]) @ normals[i]) >= away[i] - 1e-9
                pushes.append(normals[i] if flat else (proxy - nearest[i]) / away[i])
        elif distance_to(solid, proxy) <= radius + 1e-8:
            pushes.append(
                np.array(
                    [
                        (
                            distance_to(solid, proxy + step * axis)
                            - distance_to(solid, proxy - step * axis)
                        )
                        / (2.0 * step)
                        for axis in np.eye(3)
                    ]
                )
            )
    deflection = proxy - device
    if not pushes:
        return float(np.linalg.norm(deflection))
    from scipy.optimize import nnls  # 0.3 s, for every worker

    return float(nnls(np.array(pushes).T, deflection)[1])


def turned(triangles: Array, roll: float, pitch: float, yaw: float) -> Array:
    """Rotate triangles about the origin."""
    return np.ascontiguousarray(triangles @ np.array(rotation((roll, pitch, yaw))).T)


def winding(corners: Array, places: Array) -> Array:
    """Return libigl's winding number of triangles about places."""
    import igl  # 0.1 s, for every worker

    ids = np.arange(3 * len(corners), dtype=np.int64).reshape(-1, 3)
    found: Any = igl.winding_number(
        corners.reshape(-1, 3), ids, np.ascontiguousarray(places)
    )
    return np.asarray(found, dtype=np.float64)


def squared_distance(corners: Array, places: Array) -> Array:
    """Return libigl's squared distance of places from triangles [m²]."""
    import igl  # as above

    ids = np.arange(3 * len(corners)).reshape(-1, 3)
    found: Any = igl.point_mesh_squared_distance(
        places, np.ascontiguousarray(corners.reshape(-1, 3)), ids
    )[0]
    return np.asarray(found, dtype=np.float64)


def prism(outline: Array, height: float) -> tuple[Array, dict[int, Any]]:
    """Return corners and faces of a prism whose two caps are one face each."""
    count = len(outline)
    points = np.concatenate(
        [np.column_stack([outline, np.full(count, z)]) for z in (0.0, height)]
    )
    here = np.arange(count)
    there = np.roll(here, -1)
    walls = np.column_stack([here, there, there + count, here + count])
    caps = np.array([here[::-1], here + count])
    return points, {4: walls, count: caps} if count != 4 else {
        4: np.concatenate([walls, caps])
    }


def crossing_prism(outline: Array, height: float) -> Array:
    """Return the triangles of a prism whose outline may cross itself, shape (n, 3, 3).

    Its caps are fans about the origin.
    """
    count = len(outline)
    here, there = np.arange(count), np.roll(np.arange(count), -1)
    points = np.concatenate(
        [np.column_stack([outline, np.full(count, z)]) for z in (0.0, height)]
        + [[[0.0, 0.0, 0.0], [0.0, 0.0, height]]]
    )
    caps = np.column_stack([np.full(count, 2 * count), there, here])
    ids = [
        np.column_stack([here, there, there + count]),
        np.column_stack([here, there + count, here + count]),
        caps,
        caps[:, ::-1] + [count, count, 1],
    ]
    corners = points[np.concatenate(ids)]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray(corners[np.abs(across).max(axis=1) > 0.0])
