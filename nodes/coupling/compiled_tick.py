"""Compiled ticks of the coupling, for laws of taps and sections, also during a cross-fade."""

from __future__ import annotations

from typing import TYPE_CHECKING

from messages import topics
from nodes.compiled.answering import CompiledTicks
from nodes.compiled.library import Kernel
from nodes.coupling.renderer import Renderer
from nodes.coupling.state import CouplingState
from nodes.coupling.swap_schedule import SwapSchedule

if TYPE_CHECKING:
    from nodes.base.node import Node

# ticks after which the kernel stops for standby laws, which must catch up before the history
# forgets
STANDBY_TICKS = 64


class CouplingTicks(CompiledTicks[CouplingState]):
    """Compiled ticks of a coupling; a law with own code uses the plain tick."""

    def __init__(
        self, node: Node, kernel: Kernel, renderer: Renderer, schedule: SwapSchedule
    ) -> None:
        super().__init__(node, kernel, topics.PROXY, topics.FORCE)
        self._renderer, self._schedule = renderer, schedule
        self._name: str | None = None
        self._longest = self._most

    def load_state(self) -> bool:
        """Set how far the kernel may run. Return whether it can render the law."""
        renderer = self._renderer
        if renderer.watched:
            return False
        if renderer.name != self._name:
            self._name, self._fits = renderer.name, self.set_text(renderer.name)
        self.state.until = self._schedule.next_tick()
        self._most = (
            min(self._longest, STANDBY_TICKS) if renderer.standby else self._longest
        )
        return self._fits

    def store_state(self) -> None:
        """Advance fades and standby laws by the ticks done."""
        self._renderer.after_ticks()
