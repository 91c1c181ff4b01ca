"""What a proxy on a mesh is compared with: the polyhedron itself, by brute force over all its triangles.

Slow, and as simple as can be: nothing of the geometry under test is used, neither its tree nor its proxy.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from nodes.environment.shapes.tables import SKIN
from sim.arrays import Array

_MOST = 4_000_000
"""Triangles that are looked at, over all places."""


def nearest_on(corners: Array, point: Array) -> Array:
    """Nearest point of each triangle, by the corners, the edges and the face, whichever is nearest; shape (n, 3)."""
    best = corners[:, 0].copy()
    least = np.linalg.norm(best - point, axis=1)

    def take(candidates: Array, valid: Any = True) -> None:
        away = np.where(valid, np.linalg.norm(candidates - point, axis=1), np.inf)
        nearer = away < least
        best[nearer], least[nearer] = candidates[nearer], away[nearer]

    for k in range(3):
        a, b = corners[:, k], corners[:, (k + 1) % 3]
        along = np.einsum("ij,ij->i", point - a, b - a) / np.einsum("ij,ij->i", b - a, b - a)
        take(a + np.clip(along, 0.0, 1.0)[:, None] * (b - a))
    u, v, w = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], point - corners[:, 0]
    normal = np.cross(u, v)
    area = np.einsum("ij,ij->i", normal, normal)
    beta = np.einsum("ij,ij->i", np.cross(w, v), normal) / area
    gamma = np.einsum("ij,ij->i", np.cross(u, w), normal) / area
    take(corners[:, 0] + beta[:, None] * u + gamma[:, None] * v, (beta >= 0.0) & (gamma >= 0.0) & (beta + gamma <= 1.0))
    return best


def ideal_proxy(corners: Array, device: Array, tool: float, inside: bool) -> Array:
    """Give the place nearest to a device on the polyhedron, or on what a ball keeps its centre on, with the skin [m]."""
    nearest = nearest_on(corners, device)
    at: Array = nearest[np.linalg.norm(nearest - device, axis=1).argmin()]
    outward = at - device if inside else device - at
    return np.asarray(at + (tool + SKIN) * outward / np.linalg.norm(outward))


def off_polyhedron(corners: Array, path: Array, proxy: Array, tool: float) -> float:
    """Give the largest distance of proxies on a convex polyhedron about the origin from where they should be [m].

    At as many places, evenly over the path, as some seconds allow.
    """
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    places = np.unique(np.linspace(0, len(path) - 1, max(2, min(200, _MOST // len(corners)))).astype(int))
    worst = 0.0
    for k in places:
        inside = bool((np.einsum("ij,ij->i", path[k] - corners[:, 0], normals) < 0.0).all())
        worst = max(worst, float(np.linalg.norm(proxy[k] - ideal_proxy(corners, path[k], tool, inside))))
    return worst
