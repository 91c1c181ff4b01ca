"""Holes of a mesh: their rims, how broad they are, and lids of least area over small ones."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from nodes.environment.shapes.polygons import Coordinates, Ids

# places of a triangle of a lid at which its distance from the rim is measured
_PARTS = (
    np.array([(i, j, 6 - i - j) for i in range(7) for j in range(7 - i)], dtype=float)
    / 6.0
)
_MOST_PART = 0.5  # largest area of a lid [of the area of the shell that it closes]


class Hole(NamedTuple):
    """A hole of a mesh."""

    edges: int
    width: float  # extent along its longest axis [m]


class Lid(NamedTuple):
    """Triangles over a loop of a rim."""

    ids: Ids  # corners of each triangle, shape (n, 3); empty with too many edges
    shell: int  # that it closes
    part: float  # its area [of that shell's]
    breadth: float  # diameter of the largest disc within the loop [m]

    @property
    def is_piece(self) -> bool:
        """Whether the loop is the outline of a piece of a sheet, no hole in a surface."""
        return self.part > _MOST_PART


def holes(points: Coordinates, ids: Ids, found: list[list[int]]) -> list[Hole]:
    """Return the holes of rims of half-edges, the one of most edges first."""
    flat = ids.ravel()
    return sorted(
        (
            Hole(len(loop), float(np.ptp(points[flat[loop]], axis=0).max()))
            for loop in loops(ids, found)
        ),
        reverse=True,
    )


def loops(ids: Ids, found: Iterable[list[int]]) -> Iterator[list[int]]:
    """Yield the loops of rims: parts that pass each corner once."""
    flat = ids.ravel()
    for rim in found:
        way: list[int] = []
        place: dict[int, int] = {}
        for half in rim:
            corner = int(flat[half])
            if corner in place:
                first = place[corner]
                loop, way = way[first:], way[:first]
                for other in loop:
                    del place[int(flat[other])]
                yield loop
            place[corner] = len(way)
            way.append(half)
        yield way


def lids(
    points: Coordinates, ids: Ids, shell: Ids, found: Iterable[list[int]], most: int
) -> Iterator[Lid]:
    """Yield a lid over each loop of half-edges; an infinitely broad one over too many."""
    flat = ids.ravel()
    areas = shell_areas(points, ids, shell)
    for loop in found:
        mine = int(shell[loop[0] // 3])
        if not 3 <= len(loop) <= most:
            yield Lid(ids[:0], mine, 0.0, np.inf)
            continue
        corners = flat[loop][::-1]
        place = points[corners]
        triangles = lid(place)
        part = float(_areas(place[triangles]).sum() / max(areas[mine], 1e-300))
        yield Lid(corners[triangles], mine, part, breadth(place, triangles))


def shell_areas(points: Coordinates, ids: Ids, shell: Ids) -> Coordinates:
    """Return the area of each shell [m²]."""
    return np.asarray(np.bincount(shell, _areas(points[ids])))


def _areas(corners: Coordinates) -> Coordinates:
    """Return the areas of triangles, shape (n, 3, 3)."""
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray(0.5 * np.linalg.norm(across, axis=1))


def breadth(rim: Coordinates, triangles: Ids) -> float:
    """Return the diameter of the largest disc within a closed rim [m].

    Its centre is the farthest of some places of the triangles over the rim, whose corners are of
    it: the middle of each triangle's incircle, and a grid.
    """
    corners = rim[triangles]
    opposite = np.linalg.norm(np.roll(corners, -2, 1) - np.roll(corners, -1, 1), axis=2)
    total = np.maximum(opposite.sum(axis=1), 1e-300)[:, None, None]
    middle = np.einsum("ij,ijk->ik", opposite, corners)[:, None] / total
    places = np.concatenate([_PARTS @ corners, middle], axis=1).reshape(-1, 1, 3)
    along = np.roll(rim, -1, axis=0) - rim
    squared = np.maximum((along**2).sum(axis=1), 1e-300)
    away = places - rim
    part = np.clip((away * along).sum(axis=2) / squared, 0.0, 1.0)
    away -= part[:, :, None] * along
    return 2.0 * float(np.sqrt((away**2).sum(axis=2).min(axis=1).max()))


def lid(rim: Coordinates) -> Ids:
    """Return triangles of least total area over a closed rim (Barequet and Sharir 1995)."""
    count = len(rim)
    cost = np.zeros((count, count))
    middle = np.zeros((count, count), dtype=np.int64)
    for far in range(2, count):
        begin = np.arange(count - far)
        end = begin + far
        between = begin[:, None] + np.arange(1, far)
        spoke = (rim[end] - rim[begin])[:, None]
        across = np.cross(rim[between] - rim[begin, None], spoke)
        total = cost[begin[:, None], between] + cost[between, end[:, None]]
        total += 0.5 * np.linalg.norm(across, axis=2)
        best = total.argmin(axis=1)
        cost[begin, end] = total[begin, best]
        middle[begin, end] = between[begin, best]
    triangles = []
    waiting = [(0, count - 1)]
    while waiting:
        i, k = waiting.pop()
        if k - i >= 2:
            m = int(middle[i, k])
            triangles.append((i, m, k))
            waiting += [(i, m), (m, k)]
    return np.array(triangles, dtype=np.int64)
