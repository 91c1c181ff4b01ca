"""The surface being touched, its proxy's memory, and the change to another surface."""

from __future__ import annotations

from array import array
from collections.abc import Callable, MutableSequence
from pathlib import Path

from messages.types import Vector
from nodes.environment.meet import Numbers, meeting_of
from nodes.environment.note_tick import note_tick
from nodes.environment.shapes.scene import carry_over, identity_of, keep_offsets
from nodes.environment.shapes.tables import (
    AIM,
    ENERGY,
    INSIDE,
    MOST_POWER,
    MOVERS,
    NEVER,
    PLACED,
    ROW,
    ROWS,
)
from nodes.environment.shown_offsets import shown_table
from nodes.environment.state import JUMPED, MET, SHAPES, UNKNOWN
from nodes.environment.surfaces import Meeting, Surface, numbers_of


class TouchedSurface:
    """A surface with its proxy."""

    # maps a device position [m] to proxy, normal, distance and contact
    meet: Callable[[Vector], Meeting]

    def __init__(
        self, surface: Surface, period: float, met: MutableSequence[float] | None = None
    ) -> None:
        self._begin(numbers_of(surface, period), met)
        if self.numbers is None:
            self.meet = surface.meeting_every(period)

    @classmethod
    def of(
        cls, numbers: Numbers, met: MutableSequence[float] | None = None
    ) -> TouchedSurface:
        """Make one of the numbers of a surface, without its parameters."""
        made = cls.__new__(cls)
        made._begin(numbers, met)
        return made

    def _begin(
        self, numbers: Numbers | None, met: MutableSequence[float] | None
    ) -> None:
        self.numbers = numbers
        self._met = [0.0] * MET if met is None else met
        # Computed with the surface, not when it is replaced, which happens between two ticks.
        self._identity = (
            identity_of(self.numbers.table)
            if self.numbers is not None and self.kind == SHAPES
            else None
        )
        if self.numbers is not None:
            self.meet = meeting_of(self.numbers, self._met)

    def show(self, path: Path) -> None:
        """Put the table into a file that pages read, if a shape moves; before the first tick."""
        if self.moved is None or self.numbers is None:
            return
        self.numbers = self.numbers._replace(
            table=shown_table(self.numbers.table, path)
        )
        self.meet = meeting_of(self.numbers, self._met)

    @property
    def kind(self) -> int:
        """Kind of the surface: FREE, PLANE, ANCHOR, SHAPES or UNKNOWN."""
        return UNKNOWN if self.numbers is None else self.numbers.kind

    def note(self, seq: int, force: Vector) -> None:
        """Note the tick and the force on the device [N], before `meet`."""
        if self.numbers is not None:
            note_tick(self.kind, self.numbers.memory, seq, *force)

    def aim(self, solid: int, offset: Vector) -> None:
        """Set the offset to which a solid without a path moves [m]."""
        if self.numbers is not None:
            at = ROWS + ROW * solid + AIM
            self.numbers.table[at : at + 3] = array("d", offset)

    @property
    def moved(self) -> tuple[float, float] | None:
        """Energy [J] and largest power [W] of moving shapes; None without any."""
        if (
            self.numbers is None
            or self.kind != SHAPES
            or not self.numbers.table[MOVERS]
        ):
            return None
        return self.numbers.memory[ENERGY], self.numbers.memory[MOST_POWER]

    @property
    def jumped(self) -> bool:
        """Whether the proxy jumped in the last call: its device was lost, or came back."""
        return self.numbers is not None and self._met[JUMPED] != 0.0

    @property
    def inside(self) -> int:
        """Number of solids that are not felt because the tool began inside them."""
        return (
            int(self.numbers.memory[INSIDE])
            if self.numbers is not None and self.kind == SHAPES
            else 0
        )

    def take(self, other: TouchedSurface) -> bool:
        """Become another surface whose proxy starts at this one's. Return whether it jumps.

        If only the friction differs, the proxy keeps its memory and nothing jumps.
        """
        before, after = self.numbers, other.numbers
        jump = True
        if before is not None and after is not None and before.kind == after.kind:
            if self._identity is None or other._identity is None:
                jump = before.table != after.table
            elif self._identity[:2] == other._identity[:2]:
                after.memory[:] = before.memory
                keep_offsets(self._identity, before.table, other._identity, after.table)
                jump = False
            else:
                carry_over(self._identity, before.memory, other._identity, after.memory)
                keep_offsets(self._identity, before.table, other._identity, after.table)
        self.numbers, self.meet, self._met, self._identity = (
            after,
            other.meet,
            other._met,
            other._identity,
        )
        return jump

    def begin(self) -> None:
        """Restart the proxy at the device."""
        if self.numbers is not None and self.kind == SHAPES:
            self.numbers.memory[PLACED] = NEVER
