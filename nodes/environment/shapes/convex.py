"""Convex shapes of a few floats: distance of a point, and first hit along a step.

The distance to a convex shape along a straight line is convex, so Newton's method from outside
never steps past the first hit and converges quadratically, with one distance per iteration.
"""

from __future__ import annotations

from math import sqrt

from nodes.environment.shapes import tables as t
from nodes.environment.shapes.tables import Table, Vector4
from nodes.environment.shapes.triangle import nearest_on_triangle

_TINY = 1e-15
_STEPS = 60
_STRAIGHT = 1e-6


def gap(scene: Table, row: int, x: float, y: float, z: float) -> Vector4:
    """Return the signed distance of the tool's centre from contact [m], and the normal."""
    kind = scene[row + t.KIND]
    at = row + t.GIVEN
    on = row + t.SHIFT
    px, py, pz = x - scene[at], y - scene[at + 1], z - scene[at + 2]
    px, py, pz = px - scene[on], py - scene[on + 1], pz - scene[on + 2]
    if kind == t.PLANE:
        nx, ny, nz = scene[at + 3], scene[at + 4], scene[at + 5]
        away = px * nx + py * ny + pz * nz
    elif kind == t.SPHERE:
        away, nx, ny, nz = _from_point(px, py, pz)
        away -= scene[at + 3]
    elif kind == t.CAPSULE:
        ux, uy, uz = scene[at + 3], scene[at + 4], scene[at + 5]
        along = min(max(px * ux + py * uy + pz * uz, 0.0), scene[at + 6])
        away, nx, ny, nz = _from_point(
            px - along * ux, py - along * uy, pz - along * uz
        )
        away -= scene[at + 7]
    elif kind == t.CYLINDER:
        away, nx, ny, nz = _from_cylinder(scene, at, px, py, pz)
    else:
        away, nx, ny, nz = _from_box(scene, at, px, py, pz)
    return away - scene[t.RADIUS], nx, ny, nz


def _from_point(px: float, py: float, pz: float) -> Vector4:
    away = sqrt(px * px + py * py + pz * pz)
    if away < _TINY:
        return 0.0, 0.0, 0.0, 1.0
    return away, px / away, py / away, pz / away


def _from_cylinder(scene: Table, at: int, px: float, py: float, pz: float) -> Vector4:
    ux, uy, uz = scene[at + 3], scene[at + 4], scene[at + 5]
    along = px * ux + py * uy + pz * uz
    rx, ry, rz = px - along * ux, py - along * uy, pz - along * uz
    across = sqrt(rx * rx + ry * ry + rz * rz)
    if across > _TINY:
        rx, ry, rz = rx / across, ry / across, rz / across
    side = across - scene[at + 7]
    if along < 0.0:
        along, ux, uy, uz = -along, -ux, -uy, -uz
    end = along - scene[at + 6]
    if side > 0.0 and end > 0.0:
        away = sqrt(side * side + end * end)
        s = side / away
        e = end / away
        return away, s * rx + e * ux, s * ry + e * uy, s * rz + e * uz
    if side > end and across > _TINY:
        return side, rx, ry, rz
    return end, ux, uy, uz


def _from_box(scene: Table, at: int, px: float, py: float, pz: float) -> Vector4:
    nx = ny = nz = squares = 0.0
    outside = 0
    nearest = 0
    deepest = -1e300
    sign = 1.0
    for i in range(3):
        k = at + 3 + 3 * i
        along = px * scene[k] + py * scene[k + 1] + pz * scene[k + 2]
        side = 1.0 if along >= 0.0 else -1.0
        beyond = side * along - scene[at + 12 + i]
        if beyond > 0.0:
            outside += 1
            squares += beyond * beyond
            nx += side * beyond * scene[k]
            ny += side * beyond * scene[k + 1]
            nz += side * beyond * scene[k + 2]
        if beyond > deepest:
            deepest, nearest, sign = beyond, i, side
    if outside < 2:
        k = at + 3 + 3 * nearest
        return deepest, sign * scene[k], sign * scene[k + 1], sign * scene[k + 2]
    away = sqrt(squares)
    return away, nx / away, ny / away, nz / away


def core(
    scene: Table,
    row: int,
    face: float,
    x: float,
    y: float,
    z: float,
    nx: float,
    ny: float,
    nz: float,
) -> tuple[bool, float, float, float]:
    """Return whether the part at a normal is round, and its centre of curvature [m]."""
    kind = scene[row + t.KIND]
    at = row + t.GIVEN
    on = row + t.SHIFT
    ox, oy, oz = scene[on], scene[on + 1], scene[on + 2]
    cx, cy, cz = scene[at] + ox, scene[at + 1] + oy, scene[at + 2] + oz
    if kind == t.SPHERE:
        return True, cx, cy, cz
    if kind == t.CAPSULE or kind == t.CYLINDER:  # numba compares floats one by one
        ux, uy, uz = scene[at + 3], scene[at + 4], scene[at + 5]
        along = (x - cx) * ux + (y - cy) * uy + (z - cz) * uz
        if kind == t.CAPSULE:
            along = min(max(along, 0.0), scene[at + 6])
            return True, cx + along * ux, cy + along * uy, cz + along * uz
        if abs(nx * ux + ny * uy + nz * uz) < _STRAIGHT and abs(along) < scene[at + 6]:
            return True, cx + along * ux, cy + along * uy, cz + along * uz
    if kind == t.BOX or kind == t.CYLINDER:
        # A ball on an edge: the point that pulls lies between the shape and the ball's path around
        # it.
        away, ux, uy, uz = gap(scene, row, x, y, z)
        away += scene[t.RADIUS]
        if away > t.LIP:
            return True, x - away * ux, y - away * uy, z - away * uz
    if kind == t.MESH and scene[t.RADIUS] > t.LIP:
        qx, qy, qz, inside = nearest_on_triangle(
            scene,
            int(scene[row + t.TRIANGLES]) + t.TRIANGLE * int(face),
            x - ox,
            y - oy,
            z - oz,
        )
        if not inside:
            return True, qx + ox, qy + oy, qz + oz
    return False, 0.0, 0.0, 0.0


def convex_hit(
    scene: Table,
    row: int,
    x: float,
    y: float,
    z: float,
    sx: float,
    sy: float,
    sz: float,
) -> Vector4:
    """Return the part of a step before the tool hits a convex shape (2.0: none); the normal."""
    part, nx, ny, nz = 0.0, 0.0, 0.0, 1.0
    for _ in range(_STEPS):
        left, nx, ny, nz = gap(scene, row, x + part * sx, y + part * sy, z + part * sz)
        closing = nx * sx + ny * sy + nz * sz
        # A convex function lies above its tangent: if the tangent does not reach zero, nothing is
        # hit.
        if left + closing * (1.0 - part) >= -t.TOLERANCE:
            return 2.0, nx, ny, nz
        if left <= t.TOLERANCE:
            break
        part -= left / closing
    return part, nx, ny, nz
