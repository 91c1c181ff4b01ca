"""Repair of copies, gaps, flat triangles and T-joints of a mesh.

Each function returns the triangles as numbers of corners and counts what it repaired.
"""

from __future__ import annotations

from collections import Counter
from typing import Literal, TypeAlias

import numpy as np

from nodes.environment.shapes.mesh_edges import (
    components,
    first_of_equal,
    half_edges,
    open_edges,
    unmatched_edges,
)
from nodes.environment.shapes.polygons import Coordinates, Ids
from nodes.environment.shapes.triangle_sets import lowest_heights

RepairKind: TypeAlias = Literal[
    "degenerate",
    "repeated",
    "folded",
    "joined",
    "flat",
    "t_joints",
    "turned_faces",
    "shared_edges",
    "slits",
    "turned_shells",
    "narrow",
    "holes",
    "pieces",
]
Counts: TypeAlias = Counter[RepairKind]

MOST_OPEN = 8_000  # open edges of a mesh whose T-joints are searched
_ROUNDS = 100


def drop_copies(ids: Ids, counts: Counts, no_pairs: bool = False) -> Ids:
    """Leave out triangles of fewer than three corners, copies, and pairs back to back.

    One of each pair stays if fewer edges are open then, unless `no_pairs`.
    """
    a, b, c = ids.T
    good = (a != b) & (b != c) & (c != a)
    if not good.all():
        counts["degenerate"] += int((~good).sum())
        ids = ids[good]
    if not len(ids):
        return ids
    _, same = first_of_equal(np.sort(ids, axis=1))
    copies = np.bincount(same)[same]
    if copies.max() == 1:
        return ids
    rolled = ids[
        np.arange(len(ids))[:, None], (ids.argmin(axis=1)[:, None] + np.arange(3)) % 3
    ]
    up = np.where(rolled[:, 1] < rolled[:, 2], 1.0, 0.0)
    part_up = (np.bincount(same, up) / np.bincount(same))[same]
    folded = (part_up > 0.0) & (part_up < 1.0)
    # Of copies that look the same way the first remains.
    first = np.zeros(len(ids), dtype=bool)
    first[np.unique(same, return_index=True)[1]] = True
    keep = first & ~folded
    if folded.any() and not no_pairs:
        # Back to back, they enclose nothing, unless both are one face of a sheet drawn twice.
        fewer_open = len(open_edges(ids[keep])) > len(open_edges(ids[first]))
        if fewer_open or not keep.any():
            keep = first
            folded = np.zeros(len(ids), dtype=bool)
    counts["folded"] += int(folded.sum())
    counts["repeated"] += int((~keep & ~folded).sum())
    return np.asarray(ids[keep], dtype=np.int64)


def join_open(points: Coordinates, ids: Ids, distance: float) -> tuple[Ids, int, float]:
    """Join corners of open edges within a distance of each other.

    Returns the corner that each becomes, how many were joined, and the largest distance
    between them.
    """
    from scipy.spatial import cKDTree  # 0.2 s, for meshes that need it

    half = open_edges(ids)
    start, end, _ = half_edges(ids)
    rim = np.unique(np.concatenate([start[half], end[half]]))
    pairs = cKDTree(points[rim]).query_pairs(distance, output_type="ndarray")
    to = np.arange(len(points))
    if not len(pairs):
        return to, 0, 0.0
    parts, label = components(len(rim), pairs[:, 0], pairs[:, 1])
    first = np.full(parts, len(points))
    np.minimum.at(first, label, rim)
    to[rim] = first[label]
    moved = float(np.linalg.norm(points[rim] - points[to[rim]], axis=1).max())
    return to, len(rim) - parts, moved


def split_t_joints(
    points: Coordinates,
    ids: Ids,
    distance: float,
    counts: Counts,
    no_pairs: bool = False,
) -> Ids:
    """Split triangles at corners that lie on the middle of their unmatched edges."""
    from scipy.spatial import cKDTree  # as above

    for _ in range(20):
        half = unmatched_edges(ids, MOST_OPEN)
        if not 0 < len(half) <= MOST_OPEN:
            return ids
        start, end, _ = half_edges(ids)
        a, b = start[half], end[half]
        rim = np.unique(np.concatenate([a, b]))
        length = np.linalg.norm(points[b] - points[a], axis=1)
        tree = cKDTree(points[rim])
        middle = 0.5 * (points[a] + points[b])
        gone: set[int] = set()
        new: list[tuple[int, int, int]] = []
        for i in range(len(half)):
            triangle = int(half[i]) // 3
            if triangle in gone or length[i] <= 4.0 * distance:
                continue
            found = tree.query_ball_point(middle[i], 0.5 * length[i] + distance)
            x = int(a[i])
            y = int(b[i])
            z = int(ids[triangle].sum()) - x - y
            others = np.array(
                [n for n in rim[found].tolist() if n not in (x, y, z)], dtype=np.int64
            )
            along = (points[y] - points[x]) / length[i]
            at = (points[others] - points[x]) @ along
            off = np.linalg.norm(
                points[others] - points[x] - at[:, None] * along, axis=1
            )
            on = (off <= distance) & (at > distance) & (at < length[i] - distance)
            if on.any():
                way = [x, *others[on][np.argsort(at[on])].tolist(), y]
                gone.add(triangle)
                new += [(way[j], way[j + 1], z) for j in range(len(way) - 1)]
        if not new:
            return ids
        counts["t_joints"] += len(new) - len(gone)
        ids = np.concatenate(
            [np.delete(ids, sorted(gone), axis=0), np.array(new, dtype=np.int64)]
        )
        ids = drop_copies(ids, Counter(), no_pairs)
    return ids


def remove_flat(points: Coordinates, ids: Ids, height: float, counts: Counts) -> Ids:
    """Remove triangles that are lower than `height`.

    The ends of a shortest edge of that length are joined; else the neighbour over the longest edge
    is split.
    """
    for _ in range(_ROUNDS):
        if not len(ids):
            return ids
        heights, lengths = lowest_heights(points[ids])
        flat = np.flatnonzero(heights <= height)
        if not len(flat):
            return ids
        short = flat[lengths[flat].min(axis=1) <= 2.0 * height]
        if len(short):
            k = lengths[short].argmin(axis=1)
            parts, label = components(
                len(points), ids[short, k], ids[short, (k + 1) % 3]
            )
            first = np.full(parts, len(points))
            np.minimum.at(first, label, np.arange(len(points)))
            counts["flat"] += len(short)
            ids = drop_copies(first[label][ids], Counter())
            continue
        ids = _split_over(ids, flat, lengths, counts)
    return ids


def _split_over(ids: Ids, flat: Ids, lengths: Coordinates, counts: Counts) -> Ids:
    """Split the neighbour over the longest edge of each flat triangle at its middle corner."""
    edge = half_edges(ids)[2]
    order = np.argsort(edge, kind="stable")
    in_order = edge[order]
    used: set[int] = set()
    gone: list[int] = []
    new: list[tuple[int, int, int]] = []
    for t in flat.tolist():
        k = int(lengths[t].argmax())
        x, y, z = (int(ids[t, (k + j) % 3]) for j in range(3))
        low, high = np.searchsorted(in_order, edge[3 * t + k] + np.array([0, 1]))
        mates = [int(h) // 3 for h in order[low:high] if h != 3 * t + k]
        if t in used or (len(mates) == 1 and mates[0] in used):
            continue
        used.add(t)
        gone.append(t)
        counts["flat"] += 1
        if len(mates) == 1:
            m = mates[0]
            used.add(m)
            gone.append(m)
            j = int(np.flatnonzero((ids[m] != x) & (ids[m] != y))[0])
            w, q, r = (int(ids[m, (j + i) % 3]) for i in range(3))
            if w != z:
                new += [(q, z, w), (z, r, w)]
    rest = np.delete(ids, gone, axis=0)
    return drop_copies(
        np.concatenate([rest, np.array(new, dtype=np.int64).reshape(-1, 3)]), Counter()
    )
