"""Compiled ticks of a driver, as its loop sees them: they go ahead of the plain tick until something is unusual."""

from __future__ import annotations

from typing import NamedTuple, Protocol, TypeAlias

from messages.types import Vector

Belated: TypeAlias = tuple[tuple[bytes, bytes], float]
"""A message that came after its tick's end, and when [s]."""


class Stop(NamedTuple):
    """Where compiled ticks stopped.

    Attributes
    ----------
    seq : int
        The tick that is next, or under way.
    sent : float or None
        When its sample was published [s], where the tick is under way and waits for its answer; None before it begins.
    following : tuple of float, shape (3,), or None
        Force to be written at the start of the tick (``next_tick``) [N].
    belated : tuple or None
        What came late, and is the next thing to be looked at.
    done : int
        Ticks done.
    """

    seq: int
    sent: float | None
    following: Vector | None
    belated: Belated | None
    done: int


class Ahead(Protocol):
    """What a kind of driver may offer beside the plain tick."""

    def run(self, seq: int, end: int, epoch: float, following: Vector | None, belated: Belated | None) -> Stop:
        """Do ticks until something is unusual."""
        ...

    def rehearse(self) -> None:
        """Go the way in and out once, before the first tick."""
        ...

    def wake(self) -> None:
        """Ask them to stop after the present tick; from any thread."""
        ...
