"""Notes of a node for its surface before each answer: tick and force on the device."""

from __future__ import annotations

from collections.abc import MutableSequence

from nodes.compiled.rules import rule
from nodes.environment.shapes.tables import FORCE, NOW
from nodes.environment.state import SHAPES


@rule
def note_tick(
    kind: int, memory: MutableSequence[float], seq: int, x: float, y: float, z: float
) -> None:
    """Note the tick, and the force on the device [N], for shapes that move and regions."""
    if kind == SHAPES:
        memory[NOW] = float(seq)
        memory[FORCE], memory[FORCE + 1], memory[FORCE + 2] = x, y, z
