"""Building the scene table: one row per shape, followed by the meshes."""

from __future__ import annotations

from array import array
from collections.abc import MutableSequence, Sequence
from hashlib import blake2b
from math import cos, inf, sin, sqrt
from typing import TYPE_CHECKING, NamedTuple

from messages.types import Vector
from nodes.environment.shapes import tables as t

if TYPE_CHECKING:
    from nodes.environment.shapes.mesh import PreparedMesh


class Friction(NamedTuple):
    """Friction coefficients: static and dynamic [1], and the time a sliding proxy trails [s]."""

    static: float = 0.0
    dynamic: float = 0.0
    viscous: float = 0.0


SLIPPERY = Friction()


class Factors(NamedTuple):
    """Factors of the law on a shape: of its stiffness, and of the rest, its damping [1]."""

    stiffness: float = 1.0
    damping: float = 1.0


class ShapeMotion(NamedTuple):
    """How a shape moves: along a path, or to where a topic puts it."""

    speed: float  # largest speed [m/s]
    power: float  # largest power that it puts into the device [W]
    path: tuple[tuple[float, float, float, float], ...] = ()  # time [s] and offset [m]
    repeat: float = 0.0  # time after which the path begins again [s]; 0 for never


WHOLE = Factors()


class Solid(NamedTuple):
    """A shape as the geometry uses it: kind, numbers, friction, mesh, factors and motion."""

    kind: float
    numbers: tuple[float, ...]
    friction: Friction = SLIPPERY
    mesh: PreparedMesh | None = None
    factors: Factors = WHOLE
    motion: ShapeMotion | None = None


class FeltRegion(NamedTuple):
    """A region without a surface: its shape, and what it does inside of it."""

    shape: Solid
    effect: float  # VISCOSITY or LINE
    band: float = 1.0  # depth over which a viscous effect grows from the boundary [m]
    lag: float = 0.0  # time by which a viscous region makes the proxy trail [s]
    strength: float = 1.0  # factor of the law on a line that attracts [1]


def plane(point: Vector, normal: Vector, friction: Friction = SLIPPERY) -> Solid:
    """Return a half space, free on the side of its normal."""
    return Solid(t.PLANE, (*point, *unit(normal)), friction)


def sphere(centre: Vector, radius: float, friction: Friction = SLIPPERY) -> Solid:
    """Return a ball."""
    return Solid(t.SPHERE, (*centre, radius), friction)


def box(
    centre: Vector,
    size: Vector,
    turn: Vector = (0.0, 0.0, 0.0),
    friction: Friction = SLIPPERY,
) -> Solid:
    """Return a box of edge lengths `size` [m], turned by roll, pitch and yaw [rad]."""
    axes = zip(*rotation(turn), strict=True)
    return Solid(
        t.BOX,
        (
            *centre,
            *(number for axis in axes for number in axis),
            *(0.5 * side for side in size),
        ),
        friction,
    )


def capsule(
    start: Vector, end: Vector, radius: float, friction: Friction = SLIPPERY
) -> Solid:
    """Return all points within a radius of a straight line."""
    return Solid(
        t.CAPSULE,
        (*start, *_direction(start, end), _length(start, end), radius),
        friction,
    )


def cylinder(
    start: Vector, end: Vector, radius: float, friction: Friction = SLIPPERY
) -> Solid:
    """Return a cylinder between the centres of its ends."""
    middle = tuple(0.5 * (a + b) for a, b in zip(start, end, strict=True))
    return Solid(
        t.CYLINDER,
        (*middle, *_direction(start, end), 0.5 * _length(start, end), radius),
        friction,
    )


def mesh(prepared: PreparedMesh, friction: Friction = SLIPPERY) -> Solid:
    """Return the solid, or the sheet, of a prepared mesh."""
    return Solid(t.MESH, (), friction, prepared)


def unit(vector: Sequence[float]) -> Vector:
    """Return the direction of a vector that is not zero."""
    x, y, z = vector
    length = sqrt(x * x + y * y + z * z)
    return x / length, y / length, z / length


def rotation(turn: Vector) -> tuple[Vector, Vector, Vector]:
    """Return the rotation matrix of roll, pitch and yaw [rad]: fixed x, y, z axes, as in URDF."""
    (a, b, c) = tuple(map(cos, turn))
    (d, e, f) = tuple(map(sin, turn))
    return (
        (c * b, c * e * d - f * a, c * e * a + f * d),
        (f * b, f * e * d + c * a, f * e * a - c * d),
        (-e, b * d, b * a),
    )


def scene_table(
    solids: Sequence[Solid],
    tool_radius: float,
    period: float,
    regions: Sequence[FeltRegion] = (),
) -> array[float]:
    """Return the scene table (nodes/environment/shapes/tables.py) of shapes for one tool."""
    rows = array("d", [0.0]) * (t.ROWS + t.ROW * (len(solids) + len(regions)))
    rows[t.SHAPES], rows[t.RADIUS], rows[t.CALL_PERIOD] = (
        len(solids),
        tool_radius + t.SKIN,
        period,
    )
    rows[t.REGIONS] = len(regions)
    rows[t.MOVERS] = sum(solid.motion is not None for solid in solids)
    for n, region in enumerate(regions, len(solids)):
        at = t.ROWS + t.ROW * n
        shape = region.shape
        rows[at + t.KIND], rows[at + t.EFFECT] = shape.kind, region.effect
        rows[at + t.BAND], rows[at + t.LAG], rows[at + t.STIFF] = region[2:]
        rows[at + t.GIVEN : at + t.GIVEN + len(shape.numbers)] = array(
            "d", shape.numbers
        )
    behind = array("d")
    for n, solid in enumerate(solids):
        at = t.ROWS + t.ROW * n
        rows[at + t.KIND] = solid.kind
        rows[at + t.STATIC : at + t.STATIC + 3] = array("d", solid.friction)
        rows[at + t.STIFF : at + t.STIFF + 2] = array("d", solid.factors)
        if solid.motion is not None:
            way = solid.motion.path
            rows[at + t.SPEED], rows[at + t.POWER] = (
                solid.motion.speed,
                solid.motion.power,
            )
            rows[at + t.WAY], rows[at + t.WAY_POINTS] = (
                len(rows) + len(behind),
                len(way),
            )
            rows[at + t.REPEAT] = solid.motion.repeat
            behind.extend(number for point in way for number in point)
        numbers = solid.numbers
        if solid.mesh is not None:
            import numpy as np

            begin = float(len(rows) + len(behind))
            found = solid.mesh
            count = len(found.corners)
            tree = begin + 12 * count
            numbers = (
                begin,
                count,
                tree,
                found.leaves,
                tree + found.boxes.size,
                float(found.closed),
            )
            triangles = np.concatenate(
                [found.corners.reshape(-1, 9), found.normals], axis=1
            )
            for part in (triangles, found.boxes, found.neighbours.astype(float)):
                behind.frombytes(part.tobytes())
        rows[at + t.GIVEN : at + t.GIVEN + len(numbers)] = array("d", numbers)
    return rows + behind


class KnownShapes(NamedTuple):
    """Identity of a scene's shapes, ignoring friction, factors and motion; and of its regions."""

    common: tuple[float, ...]  # tool radius and period, and the regions
    # kind and numbers of each shape; for a mesh, a digest of its triangles
    shapes: tuple[tuple[float | bytes, ...], ...]
    moving: frozenset[int] = frozenset()  # shapes that move; not part of the identity


def identity_of(table: array[float]) -> KnownShapes:
    """Return the identity of a scene; takes ms for a large mesh: not for the loop's thread."""
    shapes = int(table[t.SHAPES])
    regions = t.ROWS + t.ROW * shapes
    return KnownShapes(
        (*table[: t.MOVERS], *table[regions : regions + t.ROW * int(table[t.REGIONS])]),
        tuple(_shape(table, n) for n in range(shapes)),
        frozenset(
            n for n in range(shapes) if table[t.ROWS + t.ROW * n + t.SPEED] > 0.0
        ),
    )


def _shape(table: array[float], n: int) -> tuple[float | bytes, ...]:
    at = t.ROWS + t.ROW * n
    if table[at + t.KIND] != t.MESH:
        return (table[at + t.KIND], *table[at + t.GIVEN : at + t.ROW])
    first = int(table[at + t.TRIANGLES])
    triangles = table[first : first + t.TRIANGLE * int(table[at + t.COUNT])]
    return t.MESH, table[at + t.CLOSED], blake2b(triangles, digest_size=16).digest()


def matched(before: KnownShapes, after: KnownShapes) -> dict[int, int]:
    """Map each shape of scene `after` to its counterpart in `before`; each is used once.

    Equal shapes match wherever they stand in the lists. The rest match by kind: at the same place
    if both scenes have as many shapes, or if only one of that kind is left.
    """
    left = list(range(len(before.shapes)))
    found: dict[int, int] = {}

    def take(n: int, m: int) -> None:
        found[n] = m
        left.remove(m)

    new = range(len(after.shapes))
    for n in new:
        same = [m for m in left if before.shapes[m] == after.shapes[n]]
        if same:
            take(n, n if n in same else same[0])
    if len(before.shapes) == len(after.shapes):
        for n in new:
            if (
                n not in found
                and n in left
                and before.shapes[n][0] == after.shapes[n][0]
            ):
                take(n, n)
    for n in new:
        kind = after.shapes[n][0]
        alike = [m for m in left if before.shapes[m][0] == kind]
        if (
            n not in found
            and len(alike) == 1
            and sum(after.shapes[m][0] == kind for m in new if m not in found) == 1
        ):
            take(n, alike[0])
    return found


def new_memory(solids: int) -> array[float]:
    """Return the memory of a proxy that has not touched anything yet."""
    memory = array("d", [0.0]) * (t.LAST + (2 + t.FREE) * solids)
    memory[t.FELT_AS] = memory[t.FELT_AS + 1] = 1.0
    return memory


def carry_over(
    before: KnownShapes,
    memory: Sequence[float],
    after: KnownShapes,
    to_memory: MutableSequence[float],
) -> None:
    """Start the proxy of scene `after` at that of `before`; pressed shapes keep holding it.

    The next tick decides which shapes are felt (nodes/environment/shapes/beginning.py).
    """
    if memory[t.PLACED] == t.NEVER:
        return
    # A proxy whose device is lost keeps waiting until the device comes back elsewhere.
    is_lost = memory[t.PLACED] == t.LOST
    to_memory[t.AT : t.AT + 3] = array(
        "d", [inf] * 3 if is_lost else memory[t.AT : t.AT + 3]
    )
    to_memory[t.PLACED] = t.LOST if is_lost else t.CARRIED
    to_memory[t.BEFORE] = memory[t.BEFORE]
    to_memory[t.FELT_AS : t.GOAL] = array("d", memory[t.FELT_AS : t.GOAL])
    to_memory[t.ENERGY : t.LAST] = array("d", memory[t.ENERGY : t.LAST])
    shapes = len(before.shapes)
    to_shapes = len(after.shapes)
    modes = {n: memory[t.LAST + shapes + n] for n in range(shapes)}
    for i in range(int(memory[t.TOUCHED])):
        at = t.CONTACTS + t.CONTACT * i
        if memory[at + t.SHARE] > 0.0:
            modes[int(memory[at + t.SHAPE])] = t.HELD
    for n, m in matched(before, after).items():
        to_memory[t.LAST + to_shapes + n] = modes[m]


def keep_offsets(
    before: KnownShapes, table: array[float], after: KnownShapes, to_table: array[float]
) -> None:
    """Copy the offsets of moving shapes, and the aims of those without a path."""
    for n, m in matched(before, after).items() if after.moving else ():
        at = t.ROWS + t.ROW * m
        to = t.ROWS + t.ROW * n
        if n in after.moving:
            to_table[to + t.SHIFT : to + t.SHIFT + 3] = table[
                at + t.SHIFT : at + t.SHIFT + 3
            ]
            to_table[to + t.AIM : to + t.AIM + 3] = table[at + t.AIM : at + t.AIM + 3]


def _direction(start: Vector, end: Vector) -> Vector:
    return unit([b - a for a, b in zip(start, end, strict=True)])


def _length(start: Vector, end: Vector) -> float:
    return sqrt(sum((b - a) * (b - a) for a, b in zip(start, end, strict=True)))
