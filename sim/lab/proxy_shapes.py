"""Shapes on which proxies are compared, with their ideal forces in closed form."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from nodes.environment.shapes.tables import SKIN
from sim.arrays import Array
from sim.experiments.detail import hull


def icosphere(halvings: int, radius: float) -> Array:
    """Return the 20·4ⁿ triangles of a sphere, shape (n, 3, 3)."""
    golden = (1.0 + 5.0**0.5) / 2.0
    corners = np.array([(a, b * golden, 0.0) for b in (-1.0, 1.0) for a in (-1.0, 1.0)])
    corners = np.concatenate([np.roll(corners, n, axis=1) for n in range(3)])
    triangles = hull(corners)
    triangles /= np.linalg.norm(triangles, axis=2, keepdims=True)
    for _ in range(halvings):
        middle = triangles + np.roll(triangles, -1, axis=1)
        middle /= np.linalg.norm(middle, axis=2, keepdims=True)
        (a, b, c), (ab, bc, ca) = (
            np.moveaxis(triangles, 1, 0),
            np.moveaxis(middle, 1, 0),
        )
        parts = [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
        triangles = np.concatenate([np.stack(part, axis=1) for part in parts])
    return np.ascontiguousarray(radius * triangles)


def ring(ticks: int, speed: float, period: float, radius: float) -> tuple[Array, Array]:
    """Return points on a great circle tilted to the axes [m], and their normals."""
    angle = 0.1 + np.arange(ticks) * speed * period / radius
    normal = np.stack(
        [np.cos(angle), np.sin(angle) * math.cos(0.3), np.sin(angle) * math.sin(0.3)],
        axis=1,
    )
    return radius * normal, normal


_MOST = 4_000_000  # maximum number of triangles checked, over all places


def nearest_on(corners: Array, point: Array) -> Array:
    """Return the nearest point of each triangle, shape (n, 3).

    Corners, edges and face are checked.
    """
    best = corners[:, 0].copy()
    least = np.linalg.norm(best - point, axis=1)

    def take(candidates: Array, valid: Any = True) -> None:
        away = np.where(valid, np.linalg.norm(candidates - point, axis=1), np.inf)
        nearer = away < least
        best[nearer], least[nearer] = candidates[nearer], away[nearer]

    for k in range(3):
        a, b = corners[:, k], corners[:, (k + 1) % 3]
        along = np.einsum("ij,ij->i", point - a, b - a) / np.einsum(
            "ij,ij->i", b - a, b - a
        )
        take(a + np.clip(along, 0.0, 1.0)[:, None] * (b - a))
    u, v, w = (
        corners[:, 1] - corners[:, 0],
        corners[:, 2] - corners[:, 0],
        point - corners[:, 0],
    )
    normal = np.cross(u, v)
    area = np.einsum("ij,ij->i", normal, normal)
    beta = np.einsum("ij,ij->i", np.cross(w, v), normal) / area
    gamma = np.einsum("ij,ij->i", np.cross(u, w), normal) / area
    take(
        corners[:, 0] + beta[:, None] * u + gamma[:, None] * v,
        (beta >= 0.0) & (gamma >= 0.0) & (beta + gamma <= 1.0),
    )
    return best


def ideal_proxy(corners: Array, device: Array, tool: float, inside: bool) -> Array:
    """Return the ideal proxy on the polyhedron, or on its offset by a ball, with skin [m]."""
    nearest = nearest_on(corners, device)
    at: Array = nearest[np.linalg.norm(nearest - device, axis=1).argmin()]
    outward = at - device if inside else device - at
    return np.asarray(at + (tool + SKIN) * outward / np.linalg.norm(outward))


def off_polyhedron(corners: Array, path: Array, proxy: Array, tool: float) -> float:
    """Return the largest proxy error on a convex polyhedron about the origin [m].

    The path is sampled.
    """
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    places = np.unique(
        np.linspace(0, len(path) - 1, max(2, min(200, _MOST // len(corners)))).astype(
            int
        )
    )
    worst = 0.0
    for k in places:
        inside = bool(
            (np.einsum("ij,ij->i", path[k] - corners[:, 0], normals) < 0.0).all()
        )
        worst = max(
            worst,
            float(
                np.linalg.norm(proxy[k] - ideal_proxy(corners, path[k], tool, inside))
            ),
        )
    return worst
