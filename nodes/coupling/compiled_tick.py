"""The coupling's compiled ticks: laws of taps and sections, alone or in a cross-fade. A law with code of its own is plain."""

from __future__ import annotations

from typing import Any

from messages import topics
from nodes.compiled.answering import CompiledTicks
from nodes.compiled.library import Kernel
from nodes.coupling.renderer import Renderer

# the kernel stops so often for laws that stand by: they run along before the history forgets
STANDBY_TICKS = 64


class CouplingTicks(CompiledTicks):
    """The compiled ticks of a coupling."""

    def __init__(self, node: Any, kernel: Kernel, renderer: Renderer) -> None:
        super().__init__(node, kernel, topics.PROXY, topics.FORCE)
        self._coupling, self._renderer = node, renderer
        self._name: str | None = None
        self._longest = self._most

    def load_state(self) -> bool:
        """Tell the kernel how far it may go; whether the law is one of its own."""
        renderer = self._renderer
        if renderer.watched:
            return False
        if renderer.name != self._name:
            self._name, self._fits = renderer.name, self.say_text(renderer.name)
        self.state.until = self._coupling.next_swap()
        self._most = min(self._longest, STANDBY_TICKS) if renderer.standby else self._longest
        return self._fits

    def store_state(self) -> None:
        """Do what follows from the ticks."""
        self._renderer.went_on()
