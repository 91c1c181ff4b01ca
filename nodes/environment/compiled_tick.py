"""The environment's compiled ticks: surfaces that are a few numbers; any other one is met by the plain tick."""

from __future__ import annotations

from typing import Any, Protocol

from messages import topics
from nodes.base.setup import AXIS_INDEX, Setup
from nodes.environment.surfaces import Anchor, Free, Plane, Surface
from nodes.tick.answering import NEVER, CompiledTicks, Node
from nodes.tick.layout import ANCHOR, FREE, PLANE, EnvironmentState
from nodes.tick.library import Kernel


class _Environment(Node, Protocol):
    setup: Setup
    surface: Surface


class EnvironmentTicks(CompiledTicks):
    """The compiled ticks of an environment.

    Parameters
    ----------
    node : Environment
        The node.
    kernel : callable
        nodes/tick/kernels/environment.py, compiled.
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
        self._surface: Surface | None = None
        self._known = False

    def enter(self) -> bool:
        """Take over the surface, when it has changed."""
        surface = self._environment.surface
        if surface is not self._surface:
            self._surface, self._known = surface, self._take_over(surface)
        return self._known

    def _take_over(self, surface: Surface) -> bool:
        state: Any = self.state
        # Exactly these: a subclass may answer as it likes.
        if type(surface) is Free:
            state.kind = FREE
        elif type(surface) is Plane:
            state.kind, state.axis, state.normal = PLANE, AXIS_INDEX[surface.axis], float(surface.normal)
            state.point[state.axis] = surface.position
        elif type(surface) is Anchor:
            state.kind = ANCHOR
            state.point[:] = surface.position
        else:
            return False
        return True
