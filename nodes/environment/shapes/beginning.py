"""Where a proxy starts: at the device, ignoring solids that the device is inside of.

A half space pushes the device out, because its surface is known to be on one side; the coupling
ramps that force up. The nearest surface of a solid may lie on any side, and far away, so a solid
that the tool is deep inside of is not felt until the tool is outside.
"""

from __future__ import annotations

from math import inf

from nodes.environment.shapes import tables as t
from nodes.environment.shapes.convex import gap
from nodes.environment.shapes.tables import Memory, Table, Vector4
from nodes.environment.shapes.tree import mesh_gap, mesh_winding

_SHALLOW = 5e-4  # depth up to which the tool begins on the nearest surface [m]
_MOST_ROUNDS = 200
_STUCK = 0.95  # part of the depth left by the second half of the rounds above which none comes out


def shape_gap(
    scene: Table, memory: Memory, n: int, near: float, x: float, y: float, z: float
) -> Vector4:
    """Return the signed distance of the tool's centre from contact [m], and the normal.

    Beyond `near` [m], that of a mesh is within `FAR_ERROR`.
    """
    row = t.ROWS + t.ROW * n
    if scene[row + t.KIND] == t.MESH:
        shapes = int(scene[t.SHAPES])
        ball = t.LAST + 2 * shapes + t.FREE * n
        return mesh_gap(scene, row, memory, t.LAST + n, ball, near, x, y, z)
    return gap(scene, row, x, y, z)


def is_within(scene: Table, n: int, x: float, y: float, z: float) -> bool:
    """Return whether a closed mesh encloses a point, also where its shells overlap."""
    row = t.ROWS + t.ROW * n
    if scene[row + t.KIND] != t.MESH or scene[row + t.CLOSED] != 1.0:
        return False
    return mesh_winding(scene, row, x, y, z) != 0


def place(scene: Table, memory: Memory, x: float, y: float, z: float) -> None:
    """Place a proxy outside felt shapes, at the device or at its position on the last surface."""
    if memory[t.PLACED] == t.CARRIED:
        x, y, z = memory[t.AT], memory[t.AT + 1], memory[t.AT + 2]
    memory[t.PLACED] = t.ON
    memory[t.SLIDING] = memory[t.TOUCHED] = 0.0
    shapes = int(scene[t.SHAPES])
    inside = 0.0
    for n in range(shapes):
        mode = t.LAST + shapes + n
        away, _, _, _ = shape_gap(scene, memory, n, inf, x, y, z)
        deep = away + scene[t.RADIUS]
        within = is_within(scene, n, x, y, z)
        if within:
            # The nearest face may be of a shell inside of another one, and seen from outside.
            deep, away = -abs(deep), -abs(deep) - scene[t.RADIUS]
        unfelt = deep < -_SHALLOW or (memory[mode] == t.UNFELT and away < -t.TOUCH)
        if scene[t.ROWS + t.ROW * n + t.KIND] == t.PLANE or memory[mode] == t.HELD:
            unfelt = False
        memory[mode] = t.FELT
        if unfelt:
            memory[mode] = t.UNFELT
            inside += 1.0
    memory[t.INSIDE] = inside
    rounds, halfway = 0, 0.0
    while True:
        deepest = -t.TOUCH
        which = 0
        nx = 0.0
        ny = 0.0
        nz = 1.0
        for n in range(shapes):
            if memory[t.LAST + shapes + n] == t.FELT:
                away, px, py, pz = shape_gap(scene, memory, n, inf, x, y, z)
                if away < deepest:
                    deepest, which, nx, ny, nz = away, n, px, py, pz
        if deepest >= -t.TOUCH:
            break
        rounds += 1
        if rounds == _MOST_ROUNDS // 2:
            halfway = deepest
        if rounds == _MOST_ROUNDS:
            if deepest > _STUCK * halfway:
                break  # in a narrow wedge it comes out more slowly
            # No place is outside of all: the tool does not fit between them.
            memory[t.LAST + shapes + which] = t.UNFELT
            rounds = 0
            memory[t.INSIDE] += 1.0
            continue
        x, y, z = x - deepest * nx, y - deepest * ny, z - deepest * nz
    memory[t.AT], memory[t.AT + 1], memory[t.AT + 2] = x, y, z
    _leave_out_meshes(scene, memory)


def _leave_out_meshes(scene: Table, memory: Memory) -> None:
    """Stop feeling meshes that a placed proxy is in, though it came out of the nearest face.

    That face was hidden inside another shell of the mesh, or the tool does not fit into the
    crack where it came out; the next step would go through the faces that it overlaps.
    """
    shapes = int(scene[t.SHAPES])
    x, y, z = memory[t.AT], memory[t.AT + 1], memory[t.AT + 2]
    for n in range(shapes):
        mode = t.LAST + shapes + n
        if memory[mode] == t.FELT and scene[t.ROWS + t.ROW * n + t.KIND] == t.MESH:
            away, _, _, _ = shape_gap(scene, memory, n, inf, x, y, z)
            if away < -t.TOUCH or is_within(scene, n, x, y, z):
                memory[mode] = t.UNFELT
                memory[t.INSIDE] += 1.0


def leave(scene: Table, memory: Memory, x: float, y: float, z: float) -> None:
    """Feel the shapes again that both the device and its proxy have left."""
    shapes = int(scene[t.SHAPES])
    inside = 0.0
    for n in range(shapes):
        if memory[t.LAST + shapes + n] == t.UNFELT:
            left = True
            for which in range(2):
                px, py, pz = x, y, z
                if which == 1:
                    px, py, pz = memory[t.AT], memory[t.AT + 1], memory[t.AT + 2]
                if not left or is_within(scene, n, px, py, pz):
                    left = False
                    continue
                away, _, _, _ = shape_gap(scene, memory, n, t.NEAR, px, py, pz)
                left = away >= -t.TOUCH
            if left:
                memory[t.LAST + shapes + n] = t.FELT
            else:
                inside += 1.0
    memory[t.INSIDE] = inside
