"""Searching the triangles around a contact, across edges shallow enough to be smooth."""

from __future__ import annotations

from math import sqrt

from nodes.environment.shapes.tables import (
    LIP,
    NEIGHBOURS,
    PATCH,
    RADIUS,
    SEEN,
    SHIFT,
    TRIANGLE,
    TRIANGLES,
    Memory,
    Table,
)
from nodes.environment.shapes.triangle import nearest_on_triangle

_SHALLOW = 1.0718
"""Squared ratio of distances, edge over contact, for crossing an edge: 1/cos²(15°).

Between two equally near faces, an edge of up to 30° then counts as part of a smooth surface.
"""

_NEARER = 1e-13  # least gain in distance for changing the triangle [m]


def nearer_in_patch(
    scene: Table, row: int, memory: Memory, face: int, x: float, y: float, z: float
) -> tuple[bool, float, float, float]:
    """Search across shallow edges for a nearer triangle; return whether one is, and its proxy."""
    triangles = int(scene[row + TRIANGLES])
    neighbours = int(scene[row + NEIGHBOURS])
    ox, oy, oz = scene[row + SHIFT], scene[row + SHIFT + 1], scene[row + SHIFT + 2]
    x, y, z = x - ox, y - oy, z - oz
    px, py, pz, _ = nearest_on_triangle(scene, triangles + TRIANGLE * face, x, y, z)
    least = sqrt((px - x) * (px - x) + (py - y) * (py - y) + (pz - z) * (pz - z))
    first = least
    reach = _SHALLOW * least * least
    bx, by, bz, best = px, py, pz, face
    memory[SEEN] = float(face)
    seen, done = 1, 0
    while done < seen:
        at = int(memory[SEEN + done])
        done += 1
        for k in range(3):
            other = scene[neighbours + 3 * at + k]
            if other < 0.0 or seen == PATCH:
                continue
            known = False
            for i in range(seen):
                if memory[SEEN + i] == other:
                    known = True
                    break
            if known or _edge(scene, triangles + TRIANGLE * at, k, x, y, z) > reach:
                continue
            memory[SEEN + seen] = other
            seen += 1
            px, py, pz, _ = nearest_on_triangle(
                scene, triangles + TRIANGLE * int(other), x, y, z
            )
            away = sqrt((px - x) * (px - x) + (py - y) * (py - y) + (pz - z) * (pz - z))
            if away < least:
                least = away
                bx = px
                by = py
                bz = pz
                best = int(other)
    if least >= first - _NEARER:
        return False, 0.0, 0.0, 0.0
    if least <= LIP:
        # The device is on that triangle: the direction between them is rounding error, or zero.
        at = triangles + TRIANGLE * best
        out = scene[RADIUS]
        bx, by, bz = bx + ox, by + oy, bz + oz
        return (
            True,
            bx + out * scene[at + 9],
            by + out * scene[at + 10],
            bz + out * scene[at + 11],
        )
    out = scene[RADIUS] / least
    bx, by, bz = bx + out * (bx - x), by + out * (by - y), bz + out * (bz - z)
    return True, bx + ox, by + oy, bz + oz


def _edge(scene: Table, at: int, k: int, x: float, y: float, z: float) -> float:
    """Return the squared distance to an edge of a triangle [m²]."""
    i = at + 3 * k
    j = at + 3 * ((k + 1) % 3)
    ex, ey, ez = (
        scene[j] - scene[i],
        scene[j + 1] - scene[i + 1],
        scene[j + 2] - scene[i + 2],
    )
    px, py, pz = x - scene[i], y - scene[i + 1], z - scene[i + 2]
    along = (px * ex + py * ey + pz * ez) / (ex * ex + ey * ey + ez * ez)
    along = min(max(along, 0.0), 1.0)
    px, py, pz = px - along * ex, py - along * ey, pz - along * ez
    return px * px + py * py + pz * pz
