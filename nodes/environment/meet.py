"""Proxy of a surface given as numbers: one function for interpreted and compiled ticks.

A surface is a kind, a table of floats that is constant while it is touched, and a small memory of
its proxy.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, MutableSequence
from typing import NamedTuple

from messages.types import Vector
from nodes.environment.flat import meet_flat
from nodes.environment.shapes import proxy
from nodes.environment.shapes.tables import (
    DISTANCE,
    FELT_AS,
    IN_CONTACT,
    INSIDE,
    LOST,
    NORMAL,
    ON,
    PASSED,
    PLACED,
    PROXY,
)
from nodes.environment.state import MET, SHAPES


class Numbers(NamedTuple):
    """Arguments of `meet`: kind, table, memory; repairs and widths of its meshes.

    The table of a PLANE is (axis, coordinate, side), that of an ANCHOR the point.
    """

    kind: int
    table: array[float]
    memory: array[float]
    repairs: tuple[str, ...] = ()
    widths: tuple[str, ...] = ()


def meet(
    kind: int,
    table: MutableSequence[float],
    memory: MutableSequence[float],
    x: float,
    y: float,
    z: float,
    met: MutableSequence[float],
) -> bool:
    """Move the proxy for device position x, y, z [m] and write the answer into `met`.

    Return whether there is contact. `met` is laid out as `nodes.environment.state.MET` says.
    """
    if kind != SHAPES:
        return meet_flat(kind, table, x, y, z, met)
    was_lost = memory[PLACED] == LOST
    was_on = memory[PLACED] == ON
    inside = memory[INSIDE]
    proxy.meet(table, memory, x, y, z)
    contact = memory[IN_CONTACT] == 1.0
    met[0], met[1], met[2] = x, y, z
    if contact:
        met[0], met[1], met[2] = memory[PROXY], memory[PROXY + 1], memory[PROXY + 2]
    met[3], met[4], met[5] = memory[NORMAL], memory[NORMAL + 1], memory[NORMAL + 2]
    met[6] = memory[DISTANCE]
    met[8] = memory[INSIDE]
    met[9], met[10] = memory[FELT_AS], memory[FELT_AS + 1]
    # Lost, or back; or pinched by a shape that moves, and free of it or passed by it.
    jumped = was_lost != (memory[PLACED] == LOST) or (
        was_on and memory[INSIDE] > inside
    )
    jumped = jumped or memory[PASSED] == 1.0
    met[7] = 1.0 if jumped else 0.0
    return contact


def meeting_of(
    numbers: Numbers, met: MutableSequence[float] | None = None
) -> Callable[[Vector], tuple[Vector, Vector, float, bool]]:
    """Return the function of the plain tick: position [m] to proxy, normal, distance, contact.

    The answer is also written into `met`, if given.
    """
    kind, table, memory = numbers.kind, numbers.table, numbers.memory
    met = [0.0] * MET if met is None else met

    def ask(position: Vector) -> tuple[Vector, Vector, float, bool]:
        x, y, z = position
        contact = meet(kind, table, memory, x, y, z, met)
        proxy = met[0], met[1], met[2]
        normal = met[3], met[4], met[5]
        return proxy, normal, met[6], contact

    return ask
