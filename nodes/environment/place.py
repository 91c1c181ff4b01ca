"""A surface as it is touched now: its numbers, the memory of its proxy, and how another surface takes its place."""

from __future__ import annotations

from collections.abc import Callable, MutableSequence

from messages.types import Vector
from nodes.environment.meet import meeting_of
from nodes.environment.shapes.scene import carry_over, differ_in_friction_alone
from nodes.environment.shapes.tables import INSIDE, NEVER, PLACED
from nodes.environment.state import JUMPED, MET, SHAPES, UNKNOWN
from nodes.environment.surfaces import Meeting, Surface, numbers_of


class Place:
    """A surface with its proxy."""

    meet: Callable[[Vector], Meeting]  # from a device position [m] to proxy, normal, distance and contact

    def __init__(self, surface: Surface, period: float, met: MutableSequence[float] | None = None) -> None:
        self.numbers = numbers_of(surface, period)
        self._met = [0.0] * MET if met is None else met
        self.meet = surface.meeting_every(period) if self.numbers is None else meeting_of(self.numbers, self._met)

    @property
    def kind(self) -> int:
        """Kind of the surface, as numbers have it."""
        return UNKNOWN if self.numbers is None else self.numbers.kind

    @property
    def jumped(self) -> bool:
        """Whether the proxy jumped without motion in the last call: its device was lost, or has come back."""
        return self.numbers is not None and self._met[JUMPED] != 0.0

    @property
    def inside(self) -> int:
        """How many solids are not felt because the tool began inside of them."""
        return int(self.numbers.memory[INSIDE]) if self.numbers is not None and self.kind == SHAPES else 0

    def take(self, other: Place) -> bool:
        """Become another surface, whose proxy begins where this one's is. Return whether that is a jump.

        Where only friction is another, the proxy stays as it is, and nothing jumps.
        """
        before, after = self.numbers, other.numbers
        jump = True
        if before is not None and after is not None and before.kind == after.kind == SHAPES:
            if differ_in_friction_alone(before.table, after.table):
                after.memory[:] = before.memory
                jump = False
            else:
                carry_over(before.table, before.memory, after.table, after.memory)
        self.numbers, self.meet, self._met = after, other.meet, other._met
        return jump

    def begin(self) -> None:
        """Begin the proxy anew at the device."""
        if self.numbers is not None and self.kind == SHAPES:
            self.numbers.memory[PLACED] = NEVER
