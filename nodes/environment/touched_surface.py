"""A surface as it is touched now: its numbers, the memory of its proxy, and how another surface takes its place."""

from __future__ import annotations

from collections.abc import Callable, MutableSequence

from messages.types import Vector
from nodes.environment.meet import meeting_of
from nodes.environment.shapes.scene import carry_over, identity_of
from nodes.environment.shapes.tables import INSIDE, NEVER, PLACED
from nodes.environment.state import JUMPED, MET, SHAPES, UNKNOWN
from nodes.environment.surfaces import Meeting, Surface, numbers_of


class TouchedSurface:
    """A surface with its proxy."""

    # from a device position [m] to proxy, normal, distance and contact
    meet: Callable[[Vector], Meeting]

    def __init__(
        self, surface: Surface, period: float, met: MutableSequence[float] | None = None
    ) -> None:
        self.numbers = numbers_of(surface, period)
        self._met = [0.0] * MET if met is None else met
        # Made with the surface, not when it is taken: that is between two ticks.
        self._identity = (
            identity_of(self.numbers.table)
            if self.numbers is not None and self.kind == SHAPES
            else None
        )
        self.meet = (
            surface.meeting_every(period)
            if self.numbers is None
            else meeting_of(self.numbers, self._met)
        )

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
        return (
            int(self.numbers.memory[INSIDE])
            if self.numbers is not None and self.kind == SHAPES
            else 0
        )

    def take(self, other: TouchedSurface) -> bool:
        """Become another surface, whose proxy begins where this one's is. Return whether that is a jump.

        Where nothing or only friction is another, the proxy stays as it is, and nothing jumps.
        """
        before, after = self.numbers, other.numbers
        jump = True
        if before is not None and after is not None and before.kind == after.kind:
            if self._identity is None or other._identity is None:
                jump = before.table != after.table
            elif self._identity == other._identity:
                after.memory[:] = before.memory
                jump = False
            else:
                carry_over(self._identity, before.memory, other._identity, after.memory)
        self.numbers, self.meet, self._met, self._identity = (
            after,
            other.meet,
            other._met,
            other._identity,
        )
        return jump

    def begin(self) -> None:
        """Begin the proxy anew at the device."""
        if self.numbers is not None and self.kind == SHAPES:
            self.numbers.memory[PLACED] = NEVER
