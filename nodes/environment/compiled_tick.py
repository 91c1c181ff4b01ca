"""Compiled ticks of the environment, for surfaces given as numbers."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from messages import topics
from nodes.compiled.answering import CompiledTicks
from nodes.compiled.library import Kernel
from nodes.environment.state import SHAPES, UNKNOWN, EnvironmentState

if TYPE_CHECKING:
    from nodes.base.node import Node


class EnvironmentTicks(CompiledTicks[EnvironmentState]):
    """Compiled ticks of an environment, with a kernel that includes shapes or not.

    After each run of them `report_found` reports what they found.
    """

    def __init__(
        self, node: Node, kernel: Kernel, shapes: bool, report_found: Callable[[], None]
    ) -> None:
        super().__init__(node, kernel, topics.DEVICE_STATE, topics.PROXY)
        self._report_found = report_found
        self._unmet = {UNKNOWN} if shapes else {UNKNOWN, SHAPES}

    def load_state(self) -> bool:
        """Return whether the kernel can meet the surface."""
        return self.state.kind not in self._unmet

    def store_state(self) -> None:
        """Report what the ticks found."""
        self._report_found()
