"""Faces of many corners cut into triangles: convex ones as fans, others by their ears."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Coordinates = NDArray[np.float64]  # corners, shape (n, 3)
Ids = NDArray[np.int64]  # numbers of corners

_ROUNDING = 1e-10  # part of a face's area below which a corner counts as straight
_MOST_CORNERS = 2000  # of a face cut by ears, whose time grows with the cube


class Faces(NamedTuple):
    """What a file has: corners, and faces as numbers of them, by their number of corners."""

    points: Coordinates  # in the file's unit, shape (n, 3)
    groups: dict[int, Ids]  # faces of k corners, shape (m, k)
    notes: tuple[str, ...]  # what was read otherwise than it stands there


def group_by_corners(faces: list[list[int]]) -> dict[int, Ids]:
    """Return faces by their number of corners k, each group of shape (m, k)."""
    groups: dict[int, list[list[int]]] = {}
    for face in faces:
        groups.setdefault(len(face), []).append(face)
    return {
        k: np.array(found, dtype=np.int64).reshape(-1, k) for k, found in groups.items()
    }


def cut_faces(points: Coordinates, groups: dict[int, Ids]) -> tuple[Ids, int, int]:
    """Return triangles, shape (n, 3); how many faces were cut by ears, and crossed themselves."""
    found = [np.zeros((0, 3), dtype=np.int64)]
    cut = 0
    crossed = 0
    for k, faces in groups.items():
        if k == 3:
            found.append(faces)
            continue
        corners = points[faces] - points[faces[:, :1]]
        normal = np.cross(corners, np.roll(corners, -1, axis=1)).sum(axis=1)  # Newell
        size = np.linalg.norm(normal, axis=1)
        unit = normal / np.maximum(size, 1e-300)[:, None]
        turn = np.einsum(
            "ijk,ik->ij",
            np.cross(
                corners - np.roll(corners, 1, 1), np.roll(corners, -1, 1) - corners
            ),
            unit,
        )
        spread = np.einsum(
            "ijk,ik->ij", np.cross(corners[:, 1:-1], corners[:, 2:]), unit
        )
        limit = _ROUNDING * np.maximum(size, 1e-300)[:, None]
        convex = (turn > limit).all(axis=1) & (spread > limit).all(axis=1)
        fans = [faces[convex][:, [0, i, i + 1]] for i in range(1, k - 1)]
        found.append(np.stack(fans, axis=1).reshape(-1, 3))
        for row in np.flatnonzero(~convex):
            if k > _MOST_CORNERS:
                raise ValueError(
                    f"has a face of {k} corners that is not convex, at most {_MOST_CORNERS} can be"
                    " cut; triangulate the mesh"
                )
            ears, forced = cut_ears(points[faces[row]], normal[row])
            found.append(faces[row][ears])
            cut = cut + 1
            crossed = crossed + forced
    return np.concatenate(found), cut, crossed


def cut_ears(corners: Coordinates, normal: Coordinates) -> tuple[Ids, bool]:
    """Cut one face, seen along its normal, best-shaped ears first; whether it crosses itself."""
    count = len(corners)
    size = float(np.linalg.norm(normal))
    if size < 1e-300:
        return np.array(
            [[0, i, i + 1] for i in range(1, count - 1)], dtype=np.int64
        ), True
    unit = normal / size
    across = np.cross(unit, np.eye(3)[np.argmin(np.abs(unit))])
    across /= np.linalg.norm(across)
    flat = (corners - corners[0]) @ np.stack([across, np.cross(unit, across)], axis=1)
    limit = 1e-12 * size
    left = list(range(count))
    ears = []
    forced = False
    marks = [_mark(flat, left, i, limit) for i in left]
    while len(left) > 3:
        i = int(np.argmax(marks))
        if marks[i] <= 0.0:
            # No ear is left: corners on a line give a flat triangle, repaired later; any other
            # face crosses itself.
            areas = [abs(_twice_area(flat, left, j)) for j in range(len(left))]
            i = int(np.argmin(areas))
            forced = forced or areas[i] > limit
        ears.append((left[i - 1], left[i], left[(i + 1) % len(left)]))
        del left[i], marks[i]
        for j in ((i - 1) % len(left), i % len(left)):
            marks[j] = _mark(flat, left, j, limit)
    return np.array([*ears, tuple(left)], dtype=np.int64), forced


def _twice_area(flat: Coordinates, left: list[int], i: int) -> float:
    a = flat[left[i - 1]]
    b = flat[left[i]]
    c = flat[left[(i + 1) % len(left)]]
    to_b = b - a
    to_c = c - a
    return float(to_b[0] * to_c[1] - to_b[1] * to_c[0])


def _mark(flat: Coordinates, left: list[int], i: int, limit: float) -> float:
    """Return the shape of an ear, twice its area over its longest edge squared; −1 if none."""
    area = _twice_area(flat, left, i)
    if area <= limit:
        return -1.0
    mine = (left[i - 1], left[i], left[(i + 1) % len(left)])
    a, b, c = flat[list(mine)]
    others = flat[[k for k in left if k not in mine]]
    inside = np.ones(len(others), dtype=bool)
    for p, q in ((a, b), (b, c), (c, a)):
        edge = q - p
        away = others - p
        side = edge[0] * away[:, 1] - edge[1] * away[:, 0]
        inside &= side >= -limit
        # A bridge to a hole passes one place twice: its other corner does not stand in the way.
        inside &= ~(others == p).all(axis=1)
    if inside.any():
        return -1.0
    sides = (b - a, c - b, a - c)
    longest = max(float((side**2).sum()) for side in sides)
    return area / longest
