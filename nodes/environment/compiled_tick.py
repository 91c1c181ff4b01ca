"""The environment's compiled ticks: surfaces that are numbers; any other one is met by the plain tick."""

from __future__ import annotations

from typing import Any

from messages import topics
from nodes.compiled.answering import CompiledTicks
from nodes.compiled.library import Kernel
from nodes.environment.state import SHAPES, UNKNOWN


class EnvironmentTicks(CompiledTicks):
    """The compiled ticks of an environment, with a kernel that knows shapes or one that does not."""

    def __init__(self, node: Any, kernel: Kernel, shapes: bool) -> None:
        super().__init__(node, kernel, topics.DEVICE_STATE, topics.PROXY)
        self._environment = node
        self._unmet = {UNKNOWN} if shapes else {UNKNOWN, SHAPES}

    def load_state(self) -> bool:
        """Tell whether the surface is one that the kernel meets."""
        return self.state.kind not in self._unmet

    def store_state(self) -> None:
        """Report what the ticks have found out."""
        self._environment.note_inside()
