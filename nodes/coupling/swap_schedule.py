"""Scheduled swaps: which law becomes active at which tick, without a request."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from nodes.compiled.layout import NEVER
from nodes.coupling.renderer import ActiveLaw, Renderer


class ScheduledSwap(NamedTuple):
    """A law that becomes active at a tick, over a ramp [ticks]."""

    tick: int
    law: ActiveLaw
    ramp: int


class SwapSchedule:
    """The swaps that are still to come, in the order of their ticks.

    In real time (`ahead`), the sections of their laws run along until then, because replaying the
    history at the swap would take longer than a tick. In lockstep nobody waits, and the one-process
    scene replays it too.
    """

    def __init__(self, renderer: Renderer, ahead: bool) -> None:
        self._renderer, self._ahead = renderer, ahead
        self.swaps: list[ScheduledSwap] = []

    def replace(self, swaps: Sequence[ScheduledSwap]) -> None:
        """Replace the swaps that are still to come (main thread)."""
        self.swaps = list(swaps)
        if self._ahead:
            self._renderer.standby = [
                law for _, law, _ in swaps if law.compiled.sections
            ]

    @property
    def names(self) -> set[str]:
        """Names of the laws that are still to come; from any thread."""
        return {law.name for _, law, _ in self.swaps}

    def next_tick(self) -> int:
        """Return the tick of the next swap, or NEVER."""
        return self.swaps[0].tick if self.swaps else NEVER

    def pop_due(self, seq: int) -> ScheduledSwap | None:
        """Remove and return a swap due at tick `seq`, its law up to date; None if none is due."""
        if self.next_tick() > seq:
            return None
        swap = self.swaps.pop(0)
        if swap.law in self._renderer.standby:
            self._renderer.standby.remove(swap.law)
        else:
            swap.law.warm_up(self._renderer.histories)
        return swap
