"""The coupling's compiled ticks: a law of taps and sections, alone. Swaps, fades and laws with code of their own are plain."""

from __future__ import annotations

from array import array
from typing import Any, Protocol

from messages import topics
from nodes.base.setup import Setup
from nodes.coupling.law_on_axis import History
from nodes.coupling.renderer import ActiveLaw, Renderer
from nodes.tick.answering import NEVER, CompiledTicks, Node
from nodes.tick.layout import CouplingState
from nodes.tick.library import Kernel


class SharedHistory(History):
    """A history whose place in the ring stands where a kernel finds it.

    Parameters
    ----------
    length : int
        How many ticks it remembers.
    state : CouplingState
        What node and kernel share.
    n : int
        Number of its axis among those of the scene.
    """

    def __init__(self, length: int, state: CouplingState, n: int) -> None:
        self._heads, self._counts, self._n = state.head, state.pushes, n
        super().__init__(length)
        state.history[n] = self.values.buffer_info()[0]

    @property
    def head(self) -> int:
        """Index of the newest value."""
        return int(self._heads[self._n])

    @head.setter
    def head(self, value: int) -> None:
        self._heads[self._n] = value

    @property
    def pushes(self) -> int:
        """Values pushed so far."""
        return int(self._counts[self._n])

    @pushes.setter
    def pushes(self, value: int) -> None:
        self._counts[self._n] = value


class _Coupling(Node, Protocol):
    """What a coupling and its compiled ticks share."""

    setup: Setup
    _renderer: Renderer
    _schedule: list[tuple[int, ActiveLaw, int]]
    _delay: float
    _revision: int


class CouplingTicks(CompiledTicks):
    """The compiled ticks of a coupling.

    Parameters
    ----------
    node : Coupling
        The node; its renderer's histories are `SharedHistory`.
    kernel : callable
        nodes/tick/kernels/coupling.py, compiled.
    state : CouplingState
        That of the histories.
    """

    state: CouplingState

    def __init__(self, node: _Coupling, kernel: Kernel, state: CouplingState) -> None:
        setup = node.setup
        super().__init__(node, kernel, state, topics.PROXY, topics.FORCE, setup.period, setup.pace == "realtime")
        self._coupling = node
        shared: Any = state
        renderer = node._renderer
        shared.axes, shared.axis[:] = len(renderer.axes), (*renderer.axes, 0, 0)[:3]
        shared.length = renderer.histories[0].length
        # A longer gap is more than the history remembers.
        shared.bears_gap = shared.length - 2
        self._law: ActiveLaw | None = None
        self._known = False

    def enter(self) -> bool:
        """Take over law, conventions and schedule."""
        node, state = self._coupling, self.state
        renderer = node._renderer
        if not renderer.alone:
            return False
        if renderer.law is not self._law:
            self._law, self._known = renderer.law, self._take_over(renderer.law)
        state.raw, state.clamp = renderer.raw, renderer.clamp
        state.revision, state.delay = node._revision, node._delay
        state.until = node._schedule[0][0] if node._schedule else NEVER
        return self._known

    def _take_over(self, law: ActiveLaw) -> bool:
        state: Any = self.state
        self._taps = array("d", law.compiled.taps)
        self._sections = array("d", [number for section in law.compiled.sections for number in section])
        # Six: two numbers of a section on three axes.
        self._undo = array("d", [0.0]) * (6 * len(law.compiled.sections))
        self.keep("taps", self._taps)
        self.keep("sections", self._sections)
        self.keep("undo", self._undo)
        state.taps_count, state.sections_count = len(self._taps), len(law.compiled.sections)
        for n, axis in enumerate(law.axes):
            state.sections_state[n] = axis.state.buffer_info()[0]
        return self.say_text(law.name)

    def leave(self, done: int) -> None:
        """Let the node know what the kernel did."""
        del done
        node = self._coupling
        node._delay = self.state.delay
        for axis in node._renderer.law.axes:
            axis.seen()
