"""Where the proxy is: one function on numbers, which every way of playing a tick runs, interpreted or compiled.

A surface is a kind, a table of floats that never changes while it is touched, and a small table of
what its proxy remembers.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, MutableSequence, Sequence
from typing import NamedTuple

from messages.types import Vector
from nodes.arithmetic import plane_distance
from nodes.compiled.rules import rule
from nodes.environment.shapes import proxy
from nodes.environment.shapes.tables import (
    DISTANCE,
    IN_CONTACT,
    INSIDE,
    LOST,
    NORMAL,
    PLACED,
    PROXY,
)
from nodes.environment.state import ANCHOR, MET, PLANE, SHAPES


class Numbers(NamedTuple):
    """A surface as `meet` takes it: FREE, PLANE (axis, coordinate, side), ANCHOR (point) or SHAPES; its repairs in words."""

    kind: int
    table: array[float]
    memory: array[float]
    repairs: tuple[str, ...] = ()


@rule
def meet_plane(position: float, surface: float, side: float) -> tuple[float, float, bool]:
    """Meet a plane across one axis: the proxy there and the signed distance [m], and whether there is contact."""
    distance = plane_distance(position, surface, side)
    contact = distance < 0.0
    return surface if contact else position, distance, contact


@rule
def meet_flat(
    kind: int, table: Sequence[float], x: float, y: float, z: float, met: MutableSequence[float]
) -> bool:
    """Let a proxy follow the device to a position [m] on a surface without shapes."""
    met[0], met[1], met[2] = x, y, z
    met[3] = met[4] = met[5] = met[6] = met[7] = met[8] = 0.0
    if kind == PLANE:
        i = int(table[0])
        met[3 + i] = table[2]
        met[i], met[6], contact = meet_plane(met[i], table[1], table[2])
        return contact
    if kind == ANCHOR:
        met[0], met[1], met[2] = table[0], table[1], table[2]
        return True
    return False


def meet(
    kind: int,
    table: Sequence[float],
    memory: MutableSequence[float],
    x: float,
    y: float,
    z: float,
    met: MutableSequence[float],
) -> bool:
    """Let a proxy follow the device to a position [m]: the answer is written into `met`; whether there is contact."""
    if kind != SHAPES:
        return meet_flat(kind, table, x, y, z, met)
    was_lost = memory[PLACED] == LOST
    proxy.meet(table, memory, x, y, z)
    contact = memory[IN_CONTACT] == 1.0
    met[0], met[1], met[2] = x, y, z
    if contact:
        met[0], met[1], met[2] = memory[PROXY], memory[PROXY + 1], memory[PROXY + 2]
    met[3], met[4], met[5] = memory[NORMAL], memory[NORMAL + 1], memory[NORMAL + 2]
    met[6] = memory[DISTANCE]
    met[8] = memory[INSIDE]
    met[7] = 1.0 if was_lost != (memory[PLACED] == LOST) else 0.0
    return contact


def meeting_of(
    numbers: Numbers, met: MutableSequence[float] | None = None
) -> Callable[[Vector], tuple[Vector, Vector, float, bool]]:
    """Build the question of the plain tick: from a device position [m] to proxy, normal, distance and contact.

    The answer is written into `met`, too, where that is given.
    """
    kind, table, memory = numbers.kind, numbers.table, numbers.memory
    met = [0.0] * MET if met is None else met

    def ask(position: Vector) -> tuple[Vector, Vector, float, bool]:
        x, y, z = position
        contact = meet(kind, table, memory, x, y, z, met)
        return (met[0], met[1], met[2]), (met[3], met[4], met[5]), met[6], contact

    return ask
