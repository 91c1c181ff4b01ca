"""One triangle: the nearest point on it, and when a moving point or ball hits it.

A triangle is stored in the scene table as three corners and its outward normal. It is hit from the
side of its normal only; a surface that is felt from both sides has each triangle twice, back to
back.
"""

from __future__ import annotations

from math import sqrt

from nodes.environment.shapes.tables import (
    EDGE,
    LIP,
    SKIN,
    TOLERANCE,
    TOUCH,
    Table,
    Vector4,
)


def nearest_on_triangle(
    scene: Table, at: int, x: float, y: float, z: float
) -> tuple[float, float, float, bool]:
    """Return the nearest point of a triangle [m], and whether it is inside the edges.

    Source: Ericson, Real-Time Collision Detection, 2005, section 5.1.5.
    """
    ax, ay, az = scene[at], scene[at + 1], scene[at + 2]
    bx, by, bz = scene[at + 3] - ax, scene[at + 4] - ay, scene[at + 5] - az
    cx, cy, cz = scene[at + 6] - ax, scene[at + 7] - ay, scene[at + 8] - az
    px, py, pz = x - ax, y - ay, z - az
    d1 = bx * px + by * py + bz * pz
    d2 = cx * px + cy * py + cz * pz
    if d1 <= 0.0 and d2 <= 0.0:
        return ax, ay, az, False
    qx, qy, qz = px - bx, py - by, pz - bz
    d3 = bx * qx + by * qy + bz * qz
    d4 = cx * qx + cy * qy + cz * qz
    if d3 >= 0.0 and d4 <= d3:
        return ax + bx, ay + by, az + bz, False
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        v = d1 / (d1 - d3)
        return ax + v * bx, ay + v * by, az + v * bz, False
    qx, qy, qz = px - cx, py - cy, pz - cz
    d5 = bx * qx + by * qy + bz * qz
    d6 = cx * qx + cy * qy + cz * qz
    if d6 >= 0.0 and d5 <= d6:
        return ax + cx, ay + cy, az + cz, False
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        w = d2 / (d2 - d6)
        return ax + w * cx, ay + w * cy, az + w * cz, False
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return (
            ax + bx + w * (cx - bx),
            ay + by + w * (cy - by),
            az + bz + w * (cz - bz),
            False,
        )
    # By the normal, not by the corners, which would lose digits for a close point.
    nx, ny, nz = scene[at + 9], scene[at + 10], scene[at + 11]
    height = px * nx + py * ny + pz * nz
    return x - height * nx, y - height * ny, z - height * nz, True


def height_above(scene: Table, at: int, x: float, y: float, z: float) -> float:
    """Return the height of a point above the plane of a triangle [m]."""
    return (
        (x - scene[at]) * scene[at + 9]
        + (y - scene[at + 1]) * scene[at + 10]
        + (z - scene[at + 2]) * scene[at + 11]
    )


def _within(scene: Table, at: int, x: float, y: float, z: float, lip: float) -> bool:
    """Return whether the projection of a point lies on the triangle, widened by `lip`."""
    nx, ny, nz = scene[at + 9], scene[at + 10], scene[at + 11]
    for k in range(3):
        i = at + 3 * k
        j = at + 3 * ((k + 1) % 3)
        ex, ey, ez = (
            scene[j] - scene[i],
            scene[j + 1] - scene[i + 1],
            scene[j + 2] - scene[i + 2],
        )
        px, py, pz = x - scene[i], y - scene[i + 1], z - scene[i + 2]
        inward = (
            px * (ny * ez - nz * ey)
            + py * (nz * ex - nx * ez)
            + pz * (nx * ey - ny * ex)
        )
        if inward < 0.0 and inward * inward > lip * lip * (ex * ex + ey * ey + ez * ez):
            return False
    return True


def triangle_gap(
    scene: Table, at: int, radius: float, x: float, y: float, z: float
) -> Vector4:
    """Return a tool's distance from contact with a triangle [m] (1.0: beside), and the normal."""
    height = height_above(scene, at, x, y, z)
    if (
        abs(height) <= radius + TOUCH
        and height >= 0.0
        and _within(scene, at, x, y, z, LIP)
    ):
        return height - radius, scene[at + 9], scene[at + 10], scene[at + 11]
    if radius > LIP:
        qx, qy, qz, inside = nearest_on_triangle(scene, at, x, y, z)
        if not inside:
            qx, qy, qz = x - qx, y - qy, z - qz
            away = sqrt(qx * qx + qy * qy + qz * qz)
            if away > LIP:
                return away - radius, qx / away, qy / away, qz / away
    return 1.0, 0.0, 0.0, 1.0


def triangle_hit(
    scene: Table,
    at: int,
    radius: float,
    x: float,
    y: float,
    z: float,
    sx: float,
    sy: float,
    sz: float,
) -> Vector4:
    """Return the part of a step before a tool hits a triangle, 2.0 for none, and the normal."""
    nx, ny, nz = scene[at + 9], scene[at + 10], scene[at + 11]
    before = height_above(scene, at, x, y, z)
    closing = nx * sx + ny * sy + nz * sz
    after = before + closing
    if before >= radius - SKIN:
        # Moving along the plane or away from it never hits, however deep in SKIN the step begins.
        if closing >= 0.0 or after >= radius - TOLERANCE:
            return 2.0, nx, ny, nz
        part = max((radius - before) / closing, 0.0)
        if _within(scene, at, x + part * sx, y + part * sy, z + part * sz, EDGE):
            return part, nx, ny, nz
        if radius <= LIP:
            # At an edge the path may lead past both sides' skin: the triangle itself is what is
            # hit.
            if after < EDGE:
                through = min(-before / closing, 1.0)
                if _within(
                    scene,
                    at,
                    x + through * sx,
                    y + through * sy,
                    z + through * sz,
                    EDGE,
                ):
                    return part, nx, ny, nz
            return 2.0, nx, ny, nz
    elif radius <= LIP:
        return 2.0, nx, ny, nz
    if before <= -radius and after <= -radius:
        return 2.0, nx, ny, nz
    rim, ux, uy, uz = _rim_hit(scene, at, radius, x, y, z, sx, sy, sz)
    # Of faces that are nearly flush, the ball is over the rim by less than a tolerance too low,
    # which is no hit, and over the triangle behind it by more. A ball that passes under the rim
    # is lower before it is over the triangle.
    if before >= radius - SKIN:
        low = min(max((radius - TOUCH - before) / closing, 0.0), 1.0)
        if rim > low and _within(
            scene, at, x + low * sx, y + low * sy, z + low * sz, EDGE
        ):
            return max((radius - before) / closing, 0.0), nx, ny, nz
    return rim, ux, uy, uz


def _rim_hit(
    scene: Table,
    at: int,
    radius: float,
    x: float,
    y: float,
    z: float,
    sx: float,
    sy: float,
    sz: float,
) -> Vector4:
    """Return when a moving ball hits an edge or a corner, and the normal."""
    best, bx, by, bz = 2.0, 0.0, 0.0, 1.0
    for k in range(3):
        i = at + 3 * k
        j = at + 3 * ((k + 1) % 3)
        px, py, pz = x - scene[i], y - scene[i + 1], z - scene[i + 2]
        part, nx, ny, nz = _ball_hit(radius, px, py, pz, sx, sy, sz)
        if part < best:
            best, bx, by, bz = part, nx, ny, nz
        ex, ey, ez = (
            scene[j] - scene[i],
            scene[j + 1] - scene[i + 1],
            scene[j + 2] - scene[i + 2],
        )
        length = sqrt(ex * ex + ey * ey + ez * ez)
        ex, ey, ez = ex / length, ey / length, ez / length
        along = px * ex + py * ey + pz * ez
        going = sx * ex + sy * ey + sz * ez
        part, nx, ny, nz = _ball_hit(
            radius,
            px - along * ex,
            py - along * ey,
            pz - along * ez,
            sx - going * ex,
            sy - going * ey,
            sz - going * ez,
        )
        if part < best and 0.0 <= along + part * going <= length:
            best, bx, by, bz = part, nx, ny, nz
    return best, bx, by, bz


def _ball_hit(
    radius: float, px: float, py: float, pz: float, sx: float, sy: float, sz: float
) -> Vector4:
    """Return when a point moving from p by s comes within a radius of the origin."""
    speed = sx * sx + sy * sy + sz * sz
    coming = px * sx + py * sy + pz * sz
    if coming >= 0.0:
        return 2.0, 0.0, 0.0, 1.0
    closest = min(-coming / speed, 1.0)
    qx, qy, qz = px + closest * sx, py + closest * sy, pz + closest * sz
    within = radius - TOLERANCE
    if qx * qx + qy * qy + qz * qz >= within * within:
        return 2.0, 0.0, 0.0, 1.0
    outside = px * px + py * py + pz * pz - radius * radius
    part = 0.0
    if outside > 0.0:
        # This form of the root avoids cancellation.
        part = outside / (-coming + sqrt(max(coming * coming - speed * outside, 0.0)))
    qx, qy, qz = px + part * sx, py + part * sy, pz + part * sz
    away = sqrt(qx * qx + qy * qy + qz * qz)
    return part, qx / away, qy / away, qz / away
