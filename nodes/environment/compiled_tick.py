"""Compiled ticks of the environment, for surfaces given as numbers."""

from __future__ import annotations

from typing import Any

from messages import topics
from nodes.compiled.answering import CompiledTicks
from nodes.compiled.library import Kernel
from nodes.environment.state import SHAPES, UNKNOWN


class EnvironmentTicks(CompiledTicks):
    """Compiled ticks of an environment, with a kernel that includes shapes or not."""

    def __init__(self, node: Any, kernel: Kernel, shapes: bool) -> None:
        super().__init__(node, kernel, topics.DEVICE_STATE, topics.PROXY)
        self._environment = node
        self._unmet = {UNKNOWN} if shapes else {UNKNOWN, SHAPES}

    def load_state(self) -> bool:
        """Return whether the kernel can meet the surface."""
        return self.state.kind not in self._unmet

    def store_state(self) -> None:
        """Report what the ticks found."""
        self._environment.note_inside()
