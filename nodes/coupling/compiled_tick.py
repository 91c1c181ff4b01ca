"""The coupling's compiled ticks: laws of taps and sections, alone or in a cross-fade. A law with code of its own is plain."""

from __future__ import annotations

from array import array
from typing import Any, NamedTuple, Protocol

from messages import topics
from nodes.base.setup import Setup
from nodes.compiled.answering import NEVER, AnsweringNode, CompiledTicks
from nodes.compiled.layout import LEAVING, CouplingState
from nodes.compiled.library import Kernel
from nodes.coupling.law_on_axis import MAX_LEAVING, Fade, History, LawOnAxis
from nodes.coupling.renderer import ActiveLaw, Renderer

STANDBY_TICKS = 64
"""After how many ticks the kernel stops for laws that stand by, whose sections run along."""

assert MAX_LEAVING <= LEAVING  # noqa: S101  # what a kernel has room for


class _Numbers(NamedTuple):
    """A law as a kernel finds it: its numbers, and their addresses and counts."""

    taps: array[float]
    sections: array[float]
    law: LawOnAxis
    told: tuple[int, int, int, int, int]


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


class _Coupling(AnsweringNode, Protocol):
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
        nodes/coupling/kernel.py, compiled.
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
        self._fades: list[Fade] = []
        self._known = False
        self._longest = self._most

    def load_state(self) -> bool:
        """Take over law, fades, conventions and schedule."""
        node, state = self._coupling, self.state
        renderer = node._renderer
        if renderer.watched:
            return False
        if renderer.law is not self._law or renderer.fades is not self._fades:
            self._law, self._fades = renderer.law, renderer.fades
            self._known = self._take_over(renderer.law, renderer.fades)
        fade = renderer.fades[0] if renderer.fades else None
        state.fade_ramp, state.fade_done = (fade.ramp, fade.done) if fade else (0, 0)
        state.raw, state.clamp = renderer.raw, renderer.clamp
        state.revision, state.delay = node._revision, node._delay
        state.until = node._schedule[0][0] if node._schedule else NEVER
        # Laws that stand by must see what is pushed before the history forgets it.
        self._most = min(self._longest, STANDBY_TICKS) if renderer.standby else self._longest
        return self._known

    def _take_over(self, law: ActiveLaw, fades: list[Fade]) -> bool:
        state: Any = self.state
        kept = [self._numbers(axis) for axis in law.axes]
        state.taps, state.taps_count, state.sections, state.sections_count, _ = kept[0].told
        for n, numbers in enumerate(kept):
            state.sections_state[n] = numbers.told[4]
        state.leaving = len(fades[0].leaving) if fades else 0
        for n, fade in enumerate(fades):
            for m, (leaving, weight) in enumerate(fade.leaving, LEAVING * n):
                numbers = self._numbers(leaving)
                kept.append(numbers)
                state.leaving_weight[m] = weight
                (
                    state.leaving_taps[m],
                    state.leaving_taps_count[m],
                    state.leaving_sections[m],
                    state.leaving_sections_count[m],
                    state.leaving_state[m],
                ) = numbers.told
        state.undo_count = sum(2 * numbers.told[3] for numbers in kept)
        undo = array("d", [0.0]) * state.undo_count
        self.keep("undo", undo)
        # What the kernel reads lives as long as it may.
        self._kept_laws = kept, undo
        return self.say_text(law.name)

    @staticmethod
    def _numbers(law: LawOnAxis) -> _Numbers:
        taps, sections = array("d", law.taps), array("d", law.coefficients)
        told = (
            taps.buffer_info()[0],
            len(taps),
            sections.buffer_info()[0],
            len(sections) // 4,
            law.state.buffer_info()[0],
        )
        return _Numbers(taps, sections, law, told)

    def store_state(self, done: int) -> None:
        """Let the node know what the kernel did."""
        del done
        node, state = self._coupling, self.state
        node._delay = state.delay
        node._renderer.went_on(state.fade_done)
