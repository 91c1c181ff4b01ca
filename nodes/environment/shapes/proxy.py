"""The proxy on shapes with friction (Zilles and Salisbury 1995; Melder and Harwin).

The proxy moves from its last position towards the device: straight until it hits a shape, then
along what it touches, until it cannot come nearer. All constraints are found in one call, not one
per tick. It never starts from the nearest point, so it does not change sides in thin walls. It
sticks while the deflection stays within the friction cone, and slides until it is back on it.

On a mesh, shallow edges stand for a smooth surface. A proxy that only descends would stay on its
triangle until the device has left the space under it, and every edge would brake by a jump. There
the proxy also searches neighbouring triangles and moves to the nearest, so that its energy depends
on the position of the device only, not on its path.
"""

from __future__ import annotations

from math import sqrt

from messages.types import Vector
from nodes.environment.shapes import tables as t
from nodes.environment.shapes.beginning import leave, place, shape_gap
from nodes.environment.shapes.carry import advance, begin_carry, end_carry, mover
from nodes.environment.shapes.convex import convex_hit, core, gap
from nodes.environment.shapes.patch import nearer_in_patch
from nodes.environment.shapes.planes import step_between
from nodes.environment.shapes.regions import find_goal
from nodes.environment.shapes.surface_friction import (
    STILL,
    carried,
    dynamic_cone,
    feel,
    slide,
    total_share,
)
from nodes.environment.shapes.tables import Memory, MovingTable, Table
from nodes.environment.shapes.tree import mesh_hit
from nodes.environment.shapes.triangle import triangle_gap

_MOST_ROUNDS = 200

# rounds in which a leap may lead away from the device; after them it is taken for a cycle
_TRUSTED = 50
# distance beyond which a device is lost [m]: it touches nothing, and its proxy waits
_FAR = 1e3
_WAITS = 0.05  # distance from its proxy beyond which a returning device restarts it [m]
_FACING = 0.2  # least cosine at which the centre of a round part gives the direction

_PARALLEL = 1e-9
_BIT = 1e-6  # distance along a crease over which its curvature is measured [m]
# least curvature term: a step along a crease is lengthened at most tenfold
_FLATTEST = 0.1
_TURNS = 9  # descents in a call: the first, and two for each patch that is tried


def meet(scene: MovingTable, memory: Memory, x: float, y: float, z: float) -> None:
    """Move the proxy to follow the device [m]; write proxy, normal, distance and contact.

    Shapes that move do so first, for the tick that the node noted in `memory`.
    """
    memory[t.ROUNDS] = memory[t.PASSED] = 0.0
    if not (abs(x) < _FAR and abs(y) < _FAR and abs(z) < _FAR):
        if memory[t.PLACED] == t.ON:
            memory[t.PLACED] = t.LOST
        memory[t.PROXY], memory[t.PROXY + 1], memory[t.PROXY + 2] = x, y, z
        memory[t.NORMAL] = memory[t.NORMAL + 1] = memory[t.NORMAL + 2] = memory[
            t.DISTANCE
        ] = memory[t.IN_CONTACT] = 0.0
        return
    if memory[t.PLACED] == t.LOST:
        memory[t.PLACED] = t.ON if _away(memory, x, y, z) < _WAITS * _WAITS else t.NEVER
    was_touched = memory[t.IN_CONTACT] == 1.0
    moving = advance(scene, memory)
    gx, gy, gz = find_goal(scene, memory, x, y, z)
    tx, ty, tz = gx, gy, gz
    before, trying, carrier = 0.0, False, 0
    # Turns below 0 are of shapes that move, and may carry the proxy with them.
    for turn in range(-moving, _TURNS):
        if turn < 0:
            carrier = mover(scene, turn + moving)
            if not begin_carry(scene, memory, carrier):
                continue
            step = t.ROWS + t.ROW * carrier + t.STEP
            tx, ty, tz = (
                memory[t.AT] + scene[step],
                memory[t.AT + 1] + scene[step + 1],
                memory[t.AT + 2] + scene[step + 2],
            )
        elif memory[t.PLACED] != t.ON:
            place(scene, memory, x, y, z)
        # Called at one place only: numba inlines it, and it is the largest part.
        held = _descend(scene, memory, tx, ty, tz, turn == 0)
        if turn < 0:
            end_carry(scene, memory, carrier, tx, ty, tz)
            tx, ty, tz = gx, gy, gz
            continue
        if trying:
            trying, tx, ty, tz = False, gx, gy, gz
            continue
        if turn > 0 and _away(memory, gx, gy, gz) >= before:
            _go_back(memory)
            break
        if not held:
            break
        found, qx, qy, qz = _other_patch(scene, memory, gx, gy, gz)
        if not found:
            break
        before, trying, tx, ty, tz = _away(memory, gx, gy, gz), True, qx, qy, qz
    if memory[t.INSIDE] > 0.0:
        leave(scene, memory, x, y, z)
    _answer(scene, memory, x, y, z)
    feel(scene, memory, was_touched)


def _away(memory: Memory, x: float, y: float, z: float) -> float:
    """Return the squared distance of a point to the proxy [m²]."""
    ax, ay, az = memory[t.AT] - x, memory[t.AT + 1] - y, memory[t.AT + 2] - z
    return ax * ax + ay * ay + az * az


def _go_back(memory: Memory) -> None:
    """Restore the proxy as it was before the last patch was tried."""
    memory[t.AT], memory[t.AT + 1], memory[t.AT + 2] = (
        memory[t.BACK],
        memory[t.BACK + 1],
        memory[t.BACK + 2],
    )
    for k in range(t.CONTACT):
        memory[t.CONTACTS + k] = memory[t.BACK + 3 + k]
    memory[t.TOUCHED] = 1.0


def _descend(
    scene: Table, memory: Memory, dx: float, dy: float, dz: float, rough: bool
) -> bool:
    """Descend with the proxy towards the device. Return whether a surface holds it."""
    x, y, z = memory[t.AT], memory[t.AT + 1], memory[t.AT + 2]
    count, sliding, slid, idle = (
        int(memory[t.TOUCHED]),
        memory[t.SLIDING] == 1.0,
        0.0,
        0,
    )
    covered, nx, ny, nz, shape, face = 1.0, 0.0, 0.0, 1.0, -1.0, -1.0
    # State before the last leap: position, squared distance to the device (−1: no leap under way),
    # and whether leaps are on.
    bx, by, bz, had_slid, before_leap, leaping = x, y, z, 0.0, -1.0, True
    for turn in range(_MOST_ROUNDS):
        memory[t.ROUNDS] += 1.0
        before = count
        count = _touching(scene, memory, count, x, y, z)
        if shape >= 0.0:
            count = _add(scene, memory, count, nx, ny, nz, shape, face, x, y, z)
        idle = idle + 1 if covered <= STILL and count == before else 0
        vx, vy, vz = dx - x, dy - y, dz - z
        sx, sy, sz = step_between(memory, count, vx, vy, vz)
        length, part = sqrt(sx * sx + sy * sy + sz * sz), 1.0
        carrying, carrier, cone, coat, pressed = carried(scene, memory, count, sliding)
        held = carrying > 0
        if held and before_leap >= 0.0:
            if turn > _TRUSTED and vx * vx + vy * vy + vz * vz > before_leap:
                # It cycles: the leap did not lead to the round part that it was computed for.
                # Repeat without it.
                x, y, z, slid = bx, by, bz, had_slid
                count, covered, shape, before_leap, leaping = 0, 1.0, -1.0, -1.0, False
                continue
            before_leap = -1.0
        if rough and held and length > STILL:
            if not sliding and length > cone:
                sliding, cone = True, dynamic_cone(scene, memory, count)
            part = slide(length, cone, coat / (pressed * scene[t.CALL_PERIOD]), slid)
        if length <= STILL or part == 0.0 or idle > 2 or turn == _MOST_ROUNDS - 1:
            break
        if held and leaping and carrying < 3:
            bx, by, bz, had_slid, before_leap = (
                x,
                y,
                z,
                slid,
                vx * vx + vy * vy + vz * vz,
            )
        if carrying == 1 and leaping:
            at = t.CONTACTS + t.CONTACT * carrier
            sx, sy, sz = _around(scene, memory, at, x, y, z, dx, dy, dz, sx, sy, sz)
        elif carrying == 2 and leaping:
            sx, sy, sz = _along_crease(scene, memory, count, x, y, z, sx, sy, sz)
        leaping = leaping or held
        sx, sy, sz = part * sx, part * sy, part * sz
        go, nx, ny, nz, shape, face = _first_hit(scene, memory, x, y, z, sx, sy, sz)
        if go > 1.0 and not held:
            # nothing in the way: the device position itself, to the bit
            go, x, y, z = 1.0, dx, dy, dz
        else:
            go = min(go, 1.0)
            x, y, z = x + go * sx, y + go * sy, z + go * sz
        covered = go * sqrt(sx * sx + sy * sy + sz * sz)
        slid += covered if held else 0.0
    memory[t.AT], memory[t.AT + 1], memory[t.AT + 2] = x, y, z
    memory[t.TOUCHED] = float(count)
    if rough:
        memory[t.SLIDING] = 1.0 if slid > STILL else 0.0
    return total_share(memory, count) > 0.0


def _around(
    scene: Table,
    memory: Memory,
    at: int,
    x: float,
    y: float,
    z: float,
    dx: float,
    dy: float,
    dz: float,
    sx: float,
    sy: float,
    sz: float,
) -> Vector:
    """Return the step in a round part's tangent plane to above where the proxy comes to rest."""
    row = t.ROWS + t.ROW * int(memory[at + t.SHAPE])
    nx, ny, nz = memory[at], memory[at + 1], memory[at + 2]
    is_round, cx, cy, cz = core(scene, row, memory[at + t.FACE], dx, dy, dz, nx, ny, nz)
    if is_round:
        ox, oy, oz = dx - cx, dy - cy, dz - cz
        facing = nx * ox + ny * oy + nz * oz
        if facing > _FACING * sqrt(ox * ox + oy * oy + oz * oz):
            height = nx * (x - cx) + ny * (y - cy) + nz * (z - cz) - memory[at + t.GAP]
            far = height / facing
            return cx + far * ox - x, cy + far * oy - y, cz + far * oz - z
    return sx, sy, sz


def _along_crease(
    scene: Table,
    memory: Memory,
    count: int,
    x: float,
    y: float,
    z: float,
    sx: float,
    sy: float,
    sz: float,
) -> Vector:
    """Return the step along the crease of two surfaces (Newton's method, with curvature)."""
    tx = ty = tz = 0.0
    first = -1
    for i in range(count):
        at = t.CONTACTS + t.CONTACT * i
        if memory[at + t.SHARE] > 0.0:
            if first < 0:
                first = at
            else:
                tx = (
                    memory[first + 1] * memory[at + 2]
                    - memory[first + 2] * memory[at + 1]
                )
                ty = memory[first + 2] * memory[at] - memory[first] * memory[at + 2]
                tz = memory[first] * memory[at + 1] - memory[first + 1] * memory[at]
    length = sqrt(tx * tx + ty * ty + tz * tz)
    if length < _PARALLEL:
        return sx, sy, sz
    tx, ty, tz = tx / length, ty / length, tz / length
    steep = 1.0
    for i in range(count):
        at = t.CONTACTS + t.CONTACT * i
        if memory[at + t.SHARE] > 0.0:
            row = t.ROWS + t.ROW * int(memory[at + t.SHAPE])
            nx, ny, nz = memory[at], memory[at + 1], memory[at + 2]
            begins = follows = radius = 0.0
            is_round = False
            for n in range(2):
                on = n * _BIT
                px, py, pz = x + on * tx, y + on * ty, z + on * tz
                is_round, cx, cy, cz = core(
                    scene, row, memory[at + t.FACE], px, py, pz, nx, ny, nz
                )
                along = (cx - x) * tx + (cy - y) * ty + (cz - z) * tz
                if n == 0:
                    begins, radius = (
                        along,
                        nx * (x - cx) + ny * (y - cy) + nz * (z - cz),
                    )
                else:
                    follows = (along - begins) / _BIT
            if is_round and radius > 0.0:
                steep -= memory[at + t.SHARE] * (1.0 - follows) / radius
    more = (tx * sx + ty * sy + tz * sz) * (1.0 / max(steep, _FLATTEST) - 1.0)
    return sx + more * tx, sy + more * ty, sz + more * tz


def _first_hit(
    scene: Table,
    memory: Memory,
    x: float,
    y: float,
    z: float,
    sx: float,
    sy: float,
    sz: float,
) -> tuple[float, float, float, float, float, float]:
    """Return the part of a step before a hit (2.0: none), the normal, shape and triangle."""
    best, nx, ny, nz, shape, face = 2.0, 0.0, 0.0, 1.0, -1.0, -1.0
    shapes = int(scene[t.SHAPES])
    for n in range(shapes):
        if memory[t.LAST + shapes + n] == t.UNFELT:
            continue
        row = t.ROWS + t.ROW * n
        triangle = -1.0
        if scene[row + t.KIND] == t.MESH:
            part, px, py, pz, triangle = mesh_hit(scene, row, x, y, z, sx, sy, sz)
        else:
            part, px, py, pz = convex_hit(scene, row, x, y, z, sx, sy, sz)
        if part < best:
            best, nx, ny, nz, shape, face = part, px, py, pz, float(n), triangle
    return best, nx, ny, nz, shape, face


def _touching(
    scene: Table, memory: Memory, count: int, x: float, y: float, z: float
) -> int:
    """Discard triangles no longer touched and add other shapes touched. Return the count."""
    kept = 0
    for i in range(count):
        at = t.CONTACTS + t.CONTACT * i
        shape, face = memory[at + t.SHAPE], memory[at + t.FACE]
        if face >= 0.0:
            away, nx, ny, nz = _face_gap(scene, shape, face, x, y, z)
            if away <= t.TOUCH:
                kept = _write(memory, kept, nx, ny, nz, away, shape, face)
    shapes = int(scene[t.SHAPES])
    for n in range(shapes):
        solid = (
            scene[t.ROWS + t.ROW * n + t.KIND] != t.MESH
            and memory[t.LAST + shapes + n] == t.FELT
        )
        if solid and kept < t.MAX_CONTACTS:
            away, nx, ny, nz = gap(scene, t.ROWS + t.ROW * n, x, y, z)
            if away <= t.TOUCH:
                kept = _write(memory, kept, nx, ny, nz, away, float(n), -1.0)
    return kept


def _face_gap(
    scene: Table, shape: float, face: float, x: float, y: float, z: float
) -> tuple[float, float, float, float]:
    """Return the tool's distance from contact with a triangle of a mesh [m], and the normal."""
    row = t.ROWS + t.ROW * int(shape)
    return triangle_gap(
        scene,
        int(scene[row + t.TRIANGLES]) + t.TRIANGLE * int(face),
        scene[t.RADIUS],
        x - scene[row + t.SHIFT],
        y - scene[row + t.SHIFT + 1],
        z - scene[row + t.SHIFT + 2],
    )


def _write(
    memory: Memory,
    i: int,
    nx: float,
    ny: float,
    nz: float,
    away: float,
    shape: float,
    face: float,
) -> int:
    at = t.CONTACTS + t.CONTACT * i
    memory[at], memory[at + 1], memory[at + 2] = nx, ny, nz
    (
        memory[at + t.GAP],
        memory[at + t.SHAPE],
        memory[at + t.FACE],
        memory[at + t.SHARE],
    ) = (away, shape, face, 0.0)
    return i + 1


def _add(
    scene: Table,
    memory: Memory,
    count: int,
    nx: float,
    ny: float,
    nz: float,
    shape: float,
    face: float,
    x: float,
    y: float,
    z: float,
) -> int:
    """Add a hit to the contacts unless it is there; if all places are taken, replace the last."""
    for i in range(count):
        at = t.CONTACTS + t.CONTACT * i
        if memory[at + t.SHAPE] == shape and memory[at + t.FACE] == face:
            return count
    away = 0.0
    if face >= 0.0:
        found, _, _, _ = _face_gap(scene, shape, face, x, y, z)
        if found <= t.TOUCH:
            away = found
    return _write(memory, min(count, t.MAX_CONTACTS - 1), nx, ny, nz, away, shape, face)


def _other_patch(
    scene: Table, memory: Memory, dx: float, dy: float, dz: float
) -> tuple[bool, float, float, float]:
    """Return whether a triangle across a shallow edge is nearer, and the proxy on it.

    Always false with friction, or away from a single triangle of a mesh.
    """
    carrier, carriers = 0, 0
    for i in range(int(memory[t.TOUCHED])):
        if memory[t.CONTACTS + t.CONTACT * i + t.SHARE] > 0.0:
            carrier, carriers = t.CONTACTS + t.CONTACT * i, carriers + 1
    if carriers != 1 or memory[carrier + t.FACE] < 0.0:
        return False, 0.0, 0.0, 0.0
    row = t.ROWS + t.ROW * int(memory[carrier + t.SHAPE])
    if scene[row + t.STATIC] > 0.0 or scene[row + t.VISCOUS] > 0.0:
        return False, 0.0, 0.0, 0.0
    for k in range(3):
        memory[t.BACK + k] = memory[t.AT + k]
    for k in range(t.CONTACT):
        memory[t.BACK + 3 + k] = memory[carrier + k]
    return nearer_in_patch(
        scene, row, memory, int(memory[carrier + t.FACE]), dx, dy, dz
    )


def _answer(scene: Table, memory: Memory, x: float, y: float, z: float) -> None:
    """Write proxy, normal, signed distance and contact into memory."""
    ax, ay, az = memory[t.AT], memory[t.AT + 1], memory[t.AT + 2]
    memory[t.PROXY], memory[t.PROXY + 1], memory[t.PROXY + 2] = ax, ay, az
    nx = ny = nz = 0.0
    for i in range(int(memory[t.TOUCHED])):
        at = t.CONTACTS + t.CONTACT * i
        share = memory[at + t.SHARE]
        nx, ny, nz = (
            nx + share * memory[at],
            ny + share * memory[at + 1],
            nz + share * memory[at + 2],
        )
    length = sqrt(nx * nx + ny * ny + nz * nz)
    gx, gy, gz = memory[t.GOAL], memory[t.GOAL + 1], memory[t.GOAL + 2]
    if length == 0.0:
        # The proxy is held, but by nothing at its end point: it stopped between many constraints.
        nx, ny, nz = ax - gx, ay - gy, az - gz
        length = sqrt(nx * nx + ny * ny + nz * nz)
        if length <= STILL and (gx != x or gy != y or gz != z):
            length = 0.0  # only a region moves the goal, by less than a step
    if length > 0.0:
        nx, ny, nz = nx / length, ny / length, nz / length
        away = nx * (x - ax) + ny * (y - ay) + nz * (z - az)
        memory[t.IN_CONTACT] = 1.0
        if away > 0.0:
            # A region pulls the device to a surface from outside: from all sides, without a normal.
            away, nx, ny, nz = 0.0, 0.0, 0.0, 0.0
    elif gx != x or gy != y or gz != z:
        away, nx, ny, nz = 0.0, 0.0, 0.0, 0.0
        memory[t.IN_CONTACT] = 1.0
    else:
        away, nx, ny, nz = 1e300, 0.0, 0.0, 0.0
        shapes = int(scene[t.SHAPES])
        for n in range(shapes):
            if memory[t.LAST + shapes + n] == t.FELT:
                found, px, py, pz = shape_gap(scene, memory, n, t.NEAR, x, y, z)
                if found < away:
                    away, nx, ny, nz = found, px, py, pz
        if nx == 0.0 and ny == 0.0 and nz == 0.0:
            away = 0.0  # no shape is felt
        memory[t.IN_CONTACT] = 0.0
    memory[t.NORMAL], memory[t.NORMAL + 1], memory[t.NORMAL + 2], memory[t.DISTANCE] = (
        nx,
        ny,
        nz,
        away,
    )
