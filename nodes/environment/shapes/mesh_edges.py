"""Edges of a mesh: open ones, those of many triangles, and the shells that they join.

Half-edge ``3 t + k`` is the edge of triangle t from its corner k to its corner k + 1.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from nodes.environment.shapes.polygons import Coordinates, Ids

Flags = NDArray[np.bool_]

_MOST_TURNS = 3_000_000  # triangles that are passed on the way around all rims
MOST_SHARED = 50_000  # edges of more than two triangles that are divided by angle


def first_of_equal(rows: NDArray[np.generic]) -> tuple[Ids, Ids]:
    """Return the first row of each set of equal rows, and the set of each row."""
    order = np.lexsort(rows.T)
    in_order = rows[order]
    new = np.concatenate([[True], (in_order[1:] != in_order[:-1]).any(axis=1)])
    which = np.empty(len(rows), dtype=np.int64)
    which[order] = np.cumsum(new) - 1
    return order[new].astype(np.int64), which


def half_edges(ids: Ids) -> tuple[Ids, Ids, Ids]:
    """Return the start and end of each half-edge, and a number of its undirected edge."""
    start = ids.ravel()
    end = np.roll(ids, -1, axis=1).ravel()
    count = int(ids.max()) + 1 if len(ids) else 1
    return start, end, np.minimum(start, end) * count + np.maximum(start, end)


def open_edges(ids: Ids) -> Ids:
    """Return the half-edges that are the only one of their edge."""
    edge = half_edges(ids)[2]
    order = np.argsort(edge, kind="stable")
    first, times = _runs(edge[order])
    return np.asarray(order[first[times == 1]], dtype=np.int64)


def unmatched_edges(ids: Ids, most: int) -> Ids:
    """Return the half-edges of edges that are not passed as often one way as the other.

    Where faces disagree about outside there may be more than `most`: then only those of edges that
    an odd number of triangles have.
    """
    start, end, edge = half_edges(ids)
    order = np.argsort(edge, kind="stable")
    first, times = _runs(edge[order])
    up = np.add.reduceat((start < end)[order].astype(np.int64), first)
    found = np.sort(order[np.repeat(2 * up != times, times)])
    if len(found) > most:
        found = np.sort(order[np.repeat(times % 2 == 1, times)])
    return np.asarray(found, dtype=np.int64)


def _runs(values: Ids) -> tuple[Ids, Ids]:
    """Return the start and length of each run of equal values."""
    first = np.flatnonzero(np.concatenate([[True], values[1:] != values[:-1]]))
    return first, np.diff(np.concatenate([first, [len(values)]]))


def components(count: int, one: Ids, other: Ids) -> tuple[int, Ids]:
    """Return how many parts a graph of `count` nodes has, and the part of each node."""
    graph = coo_matrix((np.ones(len(one), dtype=np.int8), (one, other)), (count, count))
    parts, label = connected_components(graph, directed=False)
    return int(parts), label.astype(np.int64)


def orient(ids: Ids) -> tuple[Ids, int, int]:
    """Turn faces that disagree with their neighbours.

    Returns the triangles, how many were turned, and how many patches cannot agree (as a Möbius
    strip). Of the two ways to orient a patch, the one that turns fewer faces is used.
    """
    start, _, edge = half_edges(ids)
    order = np.argsort(edge, kind="stable")
    first, times = _runs(edge[order])
    one = order[first[times == 2]]
    two = order[first[times == 2] + 1]
    alike = (start[one] == start[two]).astype(np.int64)
    if not alike.any():
        return ids, 0, 0
    # Each triangle stands twice, as it is (even) and turned (odd); neighbours that pass their
    # edge alike link the one to the other.
    count, a, b = len(ids), one // 3, two // 3
    _, label = components(
        2 * count,
        np.concatenate([2 * a, 2 * a + 1]),
        np.concatenate([2 * b + alike, 2 * b + 1 - alike]),
    )
    _, patch = components(count, a, b)
    never = np.unique(patch[label[::2] == label[1::2]])
    size = np.bincount(label[::2], minlength=int(label.max()) + 1)
    chosen = np.zeros(int(patch.max()) + 1, dtype=np.int64)
    by_size = np.lexsort((size[label[::2]], patch))
    chosen[patch[by_size]] = label[::2][by_size]
    turn = (label[::2] != chosen[patch]) & ~np.isin(patch, never)
    turned = ids.copy()
    turned[turn] = ids[turn][:, ::-1]
    return turned, int(turn.sum()), len(never)


def pair(points: Coordinates, ids: Ids) -> tuple[Ids, int]:
    """Return the partner of each half-edge (−1: none), and how many edges have more than two.

    Where more than two triangles meet they are paired by angle, so that each wedge of solid is
    closed.
    """
    start, end, edge = half_edges(ids)
    order = np.argsort(edge, kind="stable")
    first, times = _runs(edge[order])
    partner = np.full(len(start), -1, dtype=np.int64)
    one = order[first[times == 2]]
    two = order[first[times == 2] + 1]
    opposite = start[one] != start[two]
    one, two = one[opposite], two[opposite]
    partner[one], partner[two] = two, one
    many = np.flatnonzero(times > 2)
    for k in many[:MOST_SHARED]:
        _pair_by_angle(
            points, ids, start, end, order[first[k] : first[k] + times[k]], partner
        )
    return partner, len(many)


def _pair_by_angle(
    points: Coordinates, ids: Ids, start: Ids, end: Ids, mine: Ids, partner: Ids
) -> None:
    low = min(start[mine[0]], end[mine[0]])
    high = max(start[mine[0]], end[mine[0]])
    axis = points[high] - points[low]
    axis = axis / np.linalg.norm(axis)
    spokes = points[ids[mine // 3, (mine % 3 + 2) % 3]] - points[low]
    spokes = spokes - (spokes @ axis)[:, None] * axis
    across = spokes[0] / max(float(np.linalg.norm(spokes[0])), 1e-300)
    angle = np.arctan2(spokes @ np.cross(axis, across), spokes @ across)
    ring = mine[np.argsort(angle, kind="stable")]
    # A face that passes its edge from low to high has its solid on the side of falling angle: it
    # bounds a wedge with the face before it.
    up = start[ring] == low
    count = len(ring)
    begin = next((r for r in range(count) if not up[r] and up[(r + 1) % count]), None)
    if begin is None:
        return
    waiting: list[int] = []
    for r in range(2 * count):
        at = (begin + r) % count
        half = int(ring[at])
        if partner[half] >= 0 or half in waiting:
            continue
        if not up[at]:
            waiting.append(half)
        elif waiting:
            other = waiting.pop()
            partner[half], partner[other] = other, half


def shells_of(count: int, partner: Ids) -> tuple[int, Ids]:
    """Return how many shells `count` triangles form over paired edges, and the shell of each."""
    half = np.flatnonzero(partner >= 0)
    return components(count, half // 3, partner[half] // 3)


def following(half: Ids | int) -> Ids | int:
    """Return the next half-edge of the same triangle."""
    return half // 3 * 3 + (half % 3 + 1) % 3


def rims(partner: Ids) -> list[list[int]]:
    """Return the rims of holes: half-edges without a partner, each rim in order."""
    left = set(np.flatnonzero(partner < 0).tolist())
    budget = _MOST_TURNS
    found = []
    while left:
        rim = [left.pop()]
        while True:
            half = int(following(rim[-1]))
            while partner[half] >= 0 and budget:
                half = int(following(int(partner[half])))
                budget = budget - 1
            if half not in left:
                break
            left.discard(half)
            rim.append(half)
        found.append(rim)
    return found
