"""Holes of a mesh: their rims, and lids of least area over small ones."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nodes.environment.shapes.polygons import Coordinates, Ids


class Hole(NamedTuple):
    """A hole of a mesh."""

    edges: int
    width: float  # extent along its longest axis [m]


def holes(points: Coordinates, ids: Ids, found: list[list[int]]) -> list[Hole]:
    """Return the holes of rims of half-edges, the one of most edges first."""
    flat = ids.ravel()
    return sorted(
        (
            Hole(len(rim), float(np.ptp(points[flat[rim]], axis=0).max()))
            for rim in found
        ),
        reverse=True,
    )


def lids(
    points: Coordinates, ids: Ids, found: list[list[int]], most: int, width: float
) -> list[Ids]:
    """Return triangles over each rim of at most `most` edges and that width."""
    flat = ids.ravel()
    added = []
    for rim in found:
        corners = flat[rim][::-1]
        place = points[corners]
        if (
            3 <= len(rim) <= most
            and float(np.ptp(place, axis=0).max()) <= width
            and len(np.unique(corners)) == len(corners)
        ):
            added.append(corners[lid(place)])
    return added


def lid(rim: Coordinates) -> Ids:
    """Return triangles of least total area over a closed rim (Barequet and Sharir 1995)."""
    count = len(rim)
    cost = np.zeros((count, count))
    middle = np.zeros((count, count), dtype=np.int64)
    for far in range(2, count):
        for i in range(count - far):
            k = i + far
            between = np.arange(i + 1, k)
            area = 0.5 * np.linalg.norm(
                np.cross(rim[between] - rim[i], rim[k] - rim[i]).reshape(-1, 3), axis=1
            )
            total = cost[i, between] + cost[between, k] + area
            best = int(total.argmin())
            cost[i, k], middle[i, k] = total[best], between[best]
    triangles = []
    waiting = [(0, count - 1)]
    while waiting:
        i, k = waiting.pop()
        if k - i >= 2:
            m = int(middle[i, k])
            triangles.append((i, m, k))
            waiting += [(i, m), (m, k)]
    return np.array(triangles, dtype=np.int64)
