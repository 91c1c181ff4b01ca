"""The bounding-volume tree of a mesh: first triangle hit by a step, and nearest triangle.

The tree is complete and stored in heap order: the root is 1, the children of k are 2k and 2k + 1.
Walking it needs no stack, because the node after k is the one to the right of the highest ancestor
that ends with it.
"""

from __future__ import annotations

from math import sqrt

from nodes.environment.shapes import tables as t
from nodes.environment.shapes.tables import Memory, Table, Vector4
from nodes.environment.shapes.triangle import (
    height_above,
    nearest_on_triangle,
    triangle_hit,
)

# far above the rounding of coordinates up to 1 km [m]
_ROUNDING = 1e-12
_FAR_PART = 1.0 / (1.0 + t.FAR_ERROR)
# the same of a search: what it finds then holds for some way [of the distance]
_SEARCHED = 1.0 / (1.0 + 0.5 * t.FAR_ERROR)


def mesh_hit(
    scene: Table,
    row: int,
    x: float,
    y: float,
    z: float,
    sx: float,
    sy: float,
    sz: float,
) -> tuple[float, float, float, float, float]:
    """Return the part of a step before a mesh is hit (2.0: none), the normal and the triangle."""
    radius, count, leaves = (
        scene[t.RADIUS],
        int(scene[row + t.COUNT]),
        int(scene[row + t.LEAVES]),
    )
    triangles = int(scene[row + t.TRIANGLES])
    tree = int(scene[row + t.TREE])
    x, y, z = (
        x - scene[row + t.SHIFT],
        y - scene[row + t.SHIFT + 1],
        z - scene[row + t.SHIFT + 2],
    )
    margin = radius + t.LIP
    best = 2.0
    bx = 0.0
    by = 0.0
    bz = 1.0
    face = -1.0
    ex, ey, ez = x + sx, y + sy, z + sz
    k = 1
    while True:
        at = tree + t.NODE * k
        if (
            min(x, ex) - margin <= scene[at + 3]
            and max(x, ex) + margin >= scene[at]
            and min(y, ey) - margin <= scene[at + 4]
            and max(y, ey) + margin >= scene[at + 1]
            and min(z, ez) - margin <= scene[at + 5]
            and max(z, ez) + margin >= scene[at + 2]
        ):
            if k < leaves:
                k = 2 * k
                continue
            j = k - leaves
            for i in range(j * count // leaves, (j + 1) * count // leaves):
                part, nx, ny, nz = triangle_hit(
                    scene, triangles + t.TRIANGLE * i, radius, x, y, z, sx, sy, sz
                )
                if part < best:
                    best = part
                    bx = nx
                    by = ny
                    bz = nz
                    face = float(i)
                    ex, ey, ez = x + part * sx, y + part * sy, z + part * sz
        while k & 1:
            k = k >> 1
        if k == 0:
            return best, bx, by, bz, face
        k += 1


def mesh_gap(
    scene: Table,
    row: int,
    memory: Memory,
    last: int,
    ball: int,
    near: float,
    x: float,
    y: float,
    z: float,
) -> Vector4:
    """Return the signed distance of the tool's centre from contact [m], and the normal.

    `last` is the place in memory of the triangle that was nearest before, `ball` that of a ball
    without triangles that the last search left. Of a mesh farther than `near` [m] any triangle may
    be returned whose distance from contact is larger than the nearest one's by `FAR_ERROR` at
    most: where many are nearly as near, as on the axis of a torus, the nearest is found only by
    asking all of them. While the ball shows that of the last triangle, nothing is searched.
    """
    count = int(scene[row + t.COUNT])
    leaves = int(scene[row + t.LEAVES])
    triangles = int(scene[row + t.TRIANGLES])
    tree = int(scene[row + t.TREE])
    x, y, z = (
        x - scene[row + t.SHIFT],
        y - scene[row + t.SHIFT + 1],
        z - scene[row + t.SHIFT + 2],
    )
    face = int(memory[last])
    qx, qy, qz, _ = nearest_on_triangle(scene, triangles + t.TRIANGLE * face, x, y, z)
    best = (x - qx) * (x - qx) + (y - qy) * (y - qy) + (z - qz) * (z - qz)
    side = height_above(scene, triangles + t.TRIANGLE * face, x, y, z)
    fx, fy, fz = x - memory[ball], y - memory[ball + 1], z - memory[ball + 2]
    free = memory[ball + 3] - sqrt(fx * fx + fy * fy + fz * fz) - scene[t.RADIUS]
    if free > near and (sqrt(best) - scene[t.RADIUS]) * _FAR_PART <= free:
        return _answer(scene, row, face, side, best, x, y, z, x - qx, y - qy, z - qz)
    reach, ux, uy, uz = _towards(x - qx, y - qy, z - qz)
    limit = _limit(best, near, scene[t.RADIUS])
    k = 1
    while True:
        at = tree + t.NODE * k
        dx = max(scene[at] - x, x - scene[at + 3], 0.0)
        dy = max(scene[at + 1] - y, y - scene[at + 4], 0.0)
        dz = max(scene[at + 2] - z, z - scene[at + 5], 0.0)
        if dx * dx + dy * dy + dz * dz <= limit:
            if k < leaves:
                k = 2 * k
                continue
            j = k - leaves
            for i in range(j * count // leaves, (j + 1) * count // leaves):
                at = triangles + t.TRIANGLE * i
                if _is_beyond(scene, at, reach, x, y, z, ux, uy, uz):
                    continue
                px, py, pz, _ = nearest_on_triangle(scene, at, x, y, z)
                away = (x - px) * (x - px) + (y - py) * (y - py) + (z - pz) * (z - pz)
                if away <= best:
                    height = height_above(scene, at, x, y, z)
                    # Of triangles that share the nearest point, the one least seen from its edge
                    # gives the side.
                    if away < best * (1.0 - 1e-9) or abs(height) > abs(side):
                        face, side = i, height
                        qx, qy, qz = px, py, pz
                        reach, ux, uy, uz = _towards(x - px, y - py, z - pz)
                    best = away
                    limit = _limit(best, near, scene[t.RADIUS])
        while k & 1:
            k = k >> 1
        if k == 0:
            break
        k += 1
    memory[last] = float(face)
    memory[ball], memory[ball + 1], memory[ball + 2] = x, y, z
    memory[ball + 3] = sqrt(limit) - _ROUNDING
    return _answer(scene, row, face, side, best, x, y, z, x - qx, y - qy, z - qz)


def _answer(
    scene: Table,
    row: int,
    face: int,
    side: float,
    squared: float,
    x: float,
    y: float,
    z: float,
    dx: float,
    dy: float,
    dz: float,
) -> Vector4:
    """Return the signed distance from contact [m], and the normal, for a nearest triangle.

    The point stands at that squared distance [m²] along `dx, dy, dz`, `side` above its plane.
    """
    away = sqrt(squared)
    behind = scene[row + t.CLOSED] == 1.0 and side < 0.0
    sign = -1.0 if behind else 1.0
    if away <= t.LIP:
        at = int(scene[row + t.TRIANGLES]) + t.TRIANGLE * face
        return (
            sign * away - scene[t.RADIUS],
            scene[at + 9],
            scene[at + 10],
            scene[at + 11],
        )
    on = row + t.SHIFT
    if (
        behind
        and mesh_winding(
            scene, row, x + scene[on], y + scene[on + 1], z + scene[on + 2]
        )
        == 0
    ):
        # where a mesh crosses itself, a face may be seen from behind outside
        sign = 1.0
    away *= sign
    return away - scene[t.RADIUS], dx / away, dy / away, dz / away


def _limit(best: float, near: float, radius: float) -> float:
    """Return the squared distance within which a nearer triangle is searched [m²].

    `best` is that of the nearest one found [m²], `near` the distance from contact up to which the
    nearest one is needed [m].
    """
    gap = max((sqrt(best) - radius) * _SEARCHED, near)
    return min(best, (radius + gap) * (radius + gap))


def _towards(dx: float, dy: float, dz: float) -> Vector4:
    """Return the length of a vector [m], rounded up by `_ROUNDING`, and its direction."""
    length = sqrt(dx * dx + dy * dy + dz * dz)
    if length == 0.0:
        return _ROUNDING, 0.0, 0.0, 0.0
    return length * (1.0 + 1e-12) + _ROUNDING, dx / length, dy / length, dz / length


def _is_beyond(
    scene: Table,
    at: int,
    reach: float,
    x: float,
    y: float,
    z: float,
    ux: float,
    uy: float,
    uz: float,
) -> bool:
    """Return whether all of a triangle is farther than `reach` from a point, along −u.

    Seen from far, it spares the search the triangles around the nearest one: they fit into
    the reach's box, but not into its ball.
    """
    for k in range(3):
        i = at + 3 * k
        px, py, pz = x - scene[i], y - scene[i + 1], z - scene[i + 2]
        if px * ux + py * uy + pz * uz <= reach:
            return False
    return True


def mesh_winding(scene: Table, row: int, x: float, y: float, z: float) -> int:
    """Return the winding number of a closed mesh about a point: 0 outside.

    It counts faces that a ray along x leaves and enters through. A point belongs to the projection
    of one of two faces at an edge, because both compute the edge in the same way.
    """
    x, y, z = (
        x - scene[row + t.SHIFT],
        y - scene[row + t.SHIFT + 1],
        z - scene[row + t.SHIFT + 2],
    )
    count = int(scene[row + t.COUNT])
    leaves = int(scene[row + t.LEAVES])
    triangles = int(scene[row + t.TRIANGLES])
    tree = int(scene[row + t.TREE])
    found, k = 0, 1
    while True:
        at = tree + t.NODE * k
        if (
            x <= scene[at + 3]
            and scene[at + 1] <= y <= scene[at + 4]
            and scene[at + 2] <= z <= scene[at + 5]
        ):
            if k < leaves:
                k = 2 * k
                continue
            j = k - leaves
            for i in range(j * count // leaves, (j + 1) * count // leaves):
                at = triangles + t.TRIANGLE * i
                if _is_across(scene, at, y, z):
                    towards = scene[at + 9]
                    height = height_above(scene, at, x, y, z)
                    if towards > 0.0 and height < 0.0:
                        found += 1
                    elif towards < 0.0 and height > 0.0:
                        found -= 1
        while k & 1:
            k = k >> 1
        if k == 0:
            return found
        k += 1


def _is_across(scene: Table, at: int, y: float, z: float) -> bool:
    """Return whether a point lies in a triangle seen along x; of two at an edge, in one."""
    inside = False
    for k in range(3):
        i = at + 3 * k
        j = at + 3 * ((k + 1) % 3)
        if (scene[i + 1] <= y) == (scene[j + 1] <= y):
            continue
        if scene[i + 1] > scene[j + 1]:
            i, j = j, i
        part = (y - scene[i + 1]) / (scene[j + 1] - scene[i + 1])
        if scene[i + 2] + part * (scene[j + 2] - scene[i + 2]) > z:
            inside = not inside
    return inside
