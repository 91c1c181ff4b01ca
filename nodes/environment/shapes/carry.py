"""Shapes that move along a path or by a topic, with the proxy carried along.

A shape never moves faster than its largest speed, and it slows down where it would put more than
its largest power into the device. A proxy that it touches, or comes over, is moved with it, along
whatever else holds the proxy; then it is outside, and the next step towards the device meets the
shape from there. A proxy that is pinched between two shapes is placed anew, as at a beginning.
"""

from __future__ import annotations

from math import inf, sqrt

from messages.types import Vector
from nodes.environment.shapes import tables as t
from nodes.environment.shapes.beginning import shape_gap
from nodes.environment.shapes.convex import convex_hit
from nodes.environment.shapes.tables import Memory, MovingTable, Table
from nodes.environment.shapes.tree import mesh_hit

_LONGEST = 0.01  # time that a shape makes up at once after ticks without a position [s]


def advance(scene: MovingTable, memory: Memory) -> int:
    """Choose the step of each moving shape in this tick. Return how many shapes move.

    At a start, and after a jump, they stand where they should be at once: none moves. After missing
    ticks they make up `_LONGEST` at most, and lag behind.
    """
    ticks = memory[t.NOW] - memory[t.BEFORE]
    if memory[t.PLACED] != t.ON or ticks <= 0.0:
        ticks = 0.0
    memory[t.BEFORE] = memory[t.NOW]
    memory[t.TICKS] = ticks
    if scene[t.MOVERS] == 0.0:
        return 0
    shapes = int(scene[t.SHAPES])
    period = scene[t.CALL_PERIOD]
    span = max(min(ticks * period, _LONGEST), period)
    for n in range(shapes):
        row = t.ROWS + t.ROW * n
        if scene[row + t.SPEED] == 0.0:
            continue
        gx, gy, gz = _aim(scene, row, memory[t.NOW] * period)
        on = row + t.SHIFT
        dx, dy, dz = gx - scene[on], gy - scene[on + 1], gz - scene[on + 2]
        if ticks == 0.0:
            scene[on], scene[on + 1], scene[on + 2] = gx, gy, gz
            dx = dy = dz = 0.0
        else:
            length = sqrt(dx * dx + dy * dy + dz * dz)
            most = scene[row + t.SPEED] * span
            if length > most:
                dx, dy, dz = (
                    dx * (most / length),
                    dy * (most / length),
                    dz * (most / length),
                )
            work, work_given = _work(memory, n, dx, dy, dz)
            most = scene[row + t.POWER] * span
            if work > most:
                part = most / work
                dx, dy, dz, work_given = (
                    part * dx,
                    part * dy,
                    part * dz,
                    part * work_given,
                )
            memory[t.ENERGY] += work_given
            memory[t.MOST_POWER] = max(memory[t.MOST_POWER], work_given / span)
        step = row + t.STEP
        scene[step], scene[step + 1], scene[step + 2] = dx, dy, dz
    return int(scene[t.MOVERS]) if ticks > 0.0 else 0


def _aim(scene: Table, row: int, time: float) -> Vector:
    """Return the offset of a shape's path at a time [s], or the offset that a topic asked for."""
    count = int(scene[row + t.WAY_POINTS])
    first = int(scene[row + t.WAY])
    if count == 0:
        return scene[row + t.AIM], scene[row + t.AIM + 1], scene[row + t.AIM + 2]
    if scene[row + t.REPEAT] > 0.0:
        time = time % scene[row + t.REPEAT]
    low = 0
    high = count - 1
    if time <= scene[first]:
        high = 0
    elif time >= scene[first + t.WAY_POINT * high]:
        low = high
    while high - low > 1:
        middle = (low + high) // 2
        if scene[first + t.WAY_POINT * middle] <= time:
            low = middle
        else:
            high = middle
    a = first + t.WAY_POINT * low
    b = first + t.WAY_POINT * high
    if low == high or scene[b] <= scene[a]:
        return scene[b + 1], scene[b + 2], scene[b + 3]
    part = (time - scene[a]) / (scene[b] - scene[a])
    return (
        scene[a + 1] + part * (scene[b + 1] - scene[a + 1]),
        scene[a + 2] + part * (scene[b + 2] - scene[a + 2]),
        scene[a + 3] + part * (scene[b + 3] - scene[a + 3]),
    )


def _work(
    memory: Memory, n: int, dx: float, dy: float, dz: float
) -> tuple[float, float]:
    """Return a bound of the work of a shape's step on what presses on it, and its work [J].

    The work is that of the force on the device. Between two shapes their forces cancel, so the
    bound also has the part that the shape's own share of the deflection has.
    """
    share = nx = ny = nz = 0.0
    for i in range(int(memory[t.TOUCHED])):
        at = t.CONTACTS + t.CONTACT * i
        if memory[at + t.SHAPE] == float(n) and memory[at + t.SHARE] > 0.0:
            part = memory[at + t.SHARE]
            share += part
            nx, ny, nz = (
                nx + part * memory[at],
                ny + part * memory[at + 1],
                nz + part * memory[at + 2],
            )
    if share == 0.0:
        return 0.0, 0.0
    fx, fy, fz = memory[t.FORCE], memory[t.FORCE + 1], memory[t.FORCE + 2]
    work = fx * dx + fy * dy + fz * dz
    ex, ey, ez = (
        memory[t.AT] - memory[t.GOAL],
        memory[t.AT + 1] - memory[t.GOAL + 1],
        memory[t.AT + 2] - memory[t.GOAL + 2],
    )
    away = sqrt(ex * ex + ey * ey + ez * ez)
    bound = work
    if away > 0.0:
        own = sqrt(fx * fx + fy * fy + fz * fz) * (nx * dx + ny * dy + nz * dz) / away
        bound = max(work, own)
    return max(bound, 0.0), work


def mover(scene: Table, which: int) -> int:
    """Return the number of the shape that moves, by its place among those that do."""
    shapes = int(scene[t.SHAPES])
    for n in range(shapes):
        if scene[t.ROWS + t.ROW * n + t.SPEED] > 0.0:
            if which == 0:
                return n
            which -= 1
    return 0


def begin_carry(scene: MovingTable, memory: Memory, n: int) -> bool:
    """Move a shape by its step. Return whether it carries the proxy, which then leaves it out."""
    row = t.ROWS + t.ROW * n
    step = row + t.STEP
    mode = t.LAST + int(scene[t.SHAPES]) + n
    dx, dy, dz = scene[step], scene[step + 1], scene[step + 2]
    far = sqrt(dx * dx + dy * dy + dz * dz)
    carries = False
    if far > 0.0 and memory[mode] == t.FELT:
        x, y, z = memory[t.AT], memory[t.AT + 1], memory[t.AT + 2]
        near = max(far + t.TOUCH, t.NEAR)
        away, _, _, _ = shape_gap(scene, memory, n, near, x, y, z)
        carries = away <= far + t.TOUCH
    for k in range(3):
        scene[row + t.SHIFT + k] += scene[step + k]
    if carries:
        memory[mode] = t.UNFELT
        memory[t.TOUCHED] = 0.0
    return carries


def end_carry(
    scene: Table, memory: Memory, n: int, tx: float, ty: float, tz: float
) -> None:
    """Feel a shape again that has carried the proxy towards a place; note where it could not.

    A proxy inside of it is placed anew. One on its other side, of a sheet or a plate thinner than
    the step, has been passed: that is a jump.
    """
    memory[t.LAST + int(scene[t.SHAPES]) + n] = t.FELT
    memory[t.TOUCHED] = 0.0
    x, y, z = memory[t.AT], memory[t.AT + 1], memory[t.AT + 2]
    away, _, _, _ = shape_gap(scene, memory, n, inf, x, y, z)
    if away < -t.TOUCH:
        memory[t.PLACED] = t.CARRIED
    elif x != tx or y != ty or z != tz:
        row = t.ROWS + t.ROW * n
        sx = x - tx
        sy = y - ty
        sz = z - tz
        if scene[row + t.KIND] == t.MESH:
            part, _, _, _, _ = mesh_hit(scene, row, tx, ty, tz, sx, sy, sz)
        else:
            part, _, _, _ = convex_hit(scene, row, tx, ty, tz, sx, sy, sz)
        if part < 1.0:
            memory[t.PASSED] = 1.0
