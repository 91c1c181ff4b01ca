"""The environment's compiled ticks: surfaces that are numbers; any other one is met by the plain tick."""

from __future__ import annotations

from typing import Protocol

from messages import topics
from nodes.base.setup import Setup
from nodes.compiled.answering import NEVER, AnsweringNode, CompiledTicks
from nodes.compiled.layout import EnvironmentState
from nodes.compiled.library import Kernel
from nodes.environment.meet import Numbers


class _Environment(AnsweringNode, Protocol):
    setup: Setup
    numbers: Numbers | None


class EnvironmentTicks(CompiledTicks):
    """The compiled ticks of an environment.

    Parameters
    ----------
    node : Environment
        The node.
    kernel : callable
        nodes/environment/kernel.py, compiled.
    """

    state: EnvironmentState

    def __init__(self, node: _Environment, kernel: Kernel) -> None:
        setup = node.setup
        super().__init__(
            node,
            kernel,
            EnvironmentState(),
            topics.DEVICE_STATE,
            topics.PROXY,
            setup.period,
            setup.pace == "realtime",
        )
        self._environment = node
        self.state.until = NEVER
        self.state.bears_gap = NEVER
        self._numbers: Numbers | None = None

    def load_state(self) -> bool:
        """Take over the surface, when it has changed."""
        numbers = self._environment.numbers
        if numbers is not None and numbers is not self._numbers:
            state = self.state
            state.kind, state.table_count, state.memory_count = numbers.kind, len(numbers.table), len(numbers.memory)
            self.keep("table", numbers.table)
            # The plain tick goes on with the same memory.
            self.keep("memory", numbers.memory)
        self._numbers = numbers
        return numbers is not None
