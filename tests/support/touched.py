"""Surfaces met tick by tick in a test, as the compiled ticks meet them."""

from __future__ import annotations

from array import array
from typing import Any

import numpy as np

from nodes.environment.meet import meet
from nodes.environment.note_tick import note_tick
from nodes.environment.state import MET, SHAPES
from nodes.environment.surfaces import parse_surface

T = 1e-3


class Touched:
    """A surface met tick by tick, with the compiled ticks' own function, interpreted."""

    def __init__(self, surface: dict[str, Any]) -> None:
        parsed = parse_surface(surface, "surface")
        parsed.check("surface")
        numbers = parsed.numbers(T)
        assert numbers is not None
        self.numbers, self.met, self.seq = numbers, array("d", [0.0] * MET), -1

    def at(
        self,
        place: tuple[float, float, float],
        force: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> tuple[np.ndarray, bool]:
        """Return the deflection of the next tick [m], and whether anything is felt."""
        self.seq += 1
        note_tick(SHAPES, self.numbers.memory, self.seq, *force)
        felt = meet(SHAPES, self.numbers.table, self.numbers.memory, *place, self.met)
        return np.array(self.met[:3]) - np.array(place), felt
