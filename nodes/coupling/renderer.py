"""The active law on all axes, and its replacement between two ticks or after a failure.

All of this runs on the loop's thread, except making and warming up a law, which happens before.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Sequence
from typing import Any

from messages.types import Proxy, Vector
from nodes.compiled.layout import state_of
from nodes.coupling.force_fields import begin_field
from nodes.coupling.law_on_axis import History, LawOnAxis, Share, shares_of
from nodes.coupling.parameters import CouplingParameters
from nodes.coupling.render import LawPort, begin_turning, deflections, make_render
from nodes.coupling.state import SLOTS, CouplingState
from nodes.laws import CompiledLaw
from nodes.parameters.store import ParameterError


class ActiveLaw:
    """A law ready to render on all axes."""

    def __init__(
        self, name: str, text: str, compiled: CompiledLaw, histories: Sequence[History]
    ) -> None:
        self.name, self.text, self.compiled = name, text, compiled
        # whether it has own code, which may raise or take too long
        self.watched = compiled.evaluate is not None
        self.axes = [
            LawOnAxis(compiled, history, n) for n, history in enumerate(histories)
        ]

    def warm_up(self, histories: Sequence[History]) -> None:
        """Update recursive sections from the histories."""
        for axis, history in zip(self.axes, histories, strict=True):
            axis.warm_up(history)

    def catch_up(self) -> None:
        """Update recursive sections with deflections pushed since the last update."""
        for axis in self.axes:
            axis.catch_up()

    def attempt(self, histories: Sequence[History]) -> None:
        """Call the law's own code once, before it renders."""
        for axis, history in zip(self.axes, histories, strict=True):
            try:
                force = axis.first_force(history)
                finite = math.isfinite(force)
            except Exception as error:  # a law of another package may raise anything
                raise ParameterError(
                    f"law {self.name!r}: raised {type(error).__name__}: {error}"
                ) from error
            if not finite:
                raise ParameterError(
                    f"law {self.name!r}: returned {force}, which is not a finite force"
                )


def settle_conventions(
    s: CouplingState, parameters: CouplingParameters, period: float
) -> None:
    """Set contact conventions, axes of the history and easing; new conventions cause a jump."""
    raw = int(parameters.history == "position")
    clamp = int(parameters.clamp)
    if (s.raw, s.clamp) != (raw, clamp):
        s.jumps = 1
    s.raw, s.clamp, s.ease_usual = raw, clamp, round(parameters.ease / period)
    begin_turning(s, parameters.frame)
    if begin_field(s, parameters.field, period):
        s.ease_ramp = max(s.ease_usual, 1)
        s.ease_done = 0


class Renderer:
    """A history per axis, the active law, laws that fade out and the fallback, in one state."""

    fallback: ActiveLaw  # renders when the law fails

    def __init__(self, axes: Sequence[int], memory: int, state: Any = None) -> None:
        s = self.state = state_of(CouplingState) if state is None else state
        self.axes = list(axes)
        s.axes, s.axis[:], s.length, s.clamp = (
            len(self.axes),
            (*axes, 0, 0)[:3],
            memory,
            1,
        )
        # one per axis
        self.histories = [History(memory, s, n) for n in range(len(self.axes))]
        # laws that become active later; their sections run along until then
        self.standby: list[ActiveLaw] = []
        self._leaving: list[list[Share]] = []
        self.watched = False  # whether a tick runs a law's own code
        self.name = ""  # name of the active law
        rings = [history.values for history in self.histories]
        laws = self._laws = [[] for _ in self.axes]  # type: list[list[LawOnAxis]]
        port = LawPort(
            ring=lambda _, n: rings[n],
            force_of=lambda _, n, m, __, head: laws[n][m].force(head),
            see=lambda _, n, m, __, head: laws[n][m].see(head),
            gain_of=lambda _, n, m: laws[n][m].gain,
            revise=lambda _, n, m, by: laws[n][m].revise(by),
        )
        self._render, self._bridge = make_render(port)

    @property
    def law(self) -> ActiveLaw:
        """The active law."""
        return self._law

    @law.setter
    def law(self, law: ActiveLaw) -> None:
        self._law = law
        self.name = law.name
        self.watched = law.watched
        self._store_laws()

    def _store_laws(self) -> None:
        """Store the rendering laws in their slots, for interpreted and compiled ticks."""
        s = self.state
        s.leaving = len(self._leaving[0]) if self._leaving else 0
        states = 0
        for n, law in enumerate(self._law.axes):
            shares = [(law, 0.0), *(self._leaving[n] if self._leaving else [])]
            self._laws[n][:] = [share[0] for share in shares]
            for slot, (one, weight) in enumerate(shares, SLOTS * n):
                s.taps[slot], s.taps_count[slot] = one.numbers.buffer_info()
                s.sections[slot], s.sections_count[slot] = (
                    one.coefficients.buffer_info()[0],
                    len(one.state) // 2,
                )
                s.sections_state[slot], s.weight[slot] = (
                    one.state.buffer_info()[0],
                    weight,
                )
                s.still[slot] = one.still
                states += len(one.state)
        self._undo = array("d", [0.0]) * states
        s.undo, s.undo_count = self._undo.buffer_info()

    def due(self) -> int:
        """Return the number that the next deflection has in each history."""
        return int(self.state.pushes[len(self.axes) - 1]) + 1

    def render(self, proxy: Proxy) -> Vector:
        """Push one tick's deflection and return the force that answers it [N]."""
        force = [0.0, 0.0, 0.0]
        self._render(
            self.state,
            proxy.position,
            proxy.proxy,
            proxy.normal,
            proxy.distance,
            proxy.contact,
            (proxy.compliance, proxy.stiffness, proxy.damping),
            force,
            self.due(),
        )
        if self._leaving or self.standby:
            self.after_ticks()
        return force[0], force[1], force[2]

    def after_ticks(self) -> None:
        """Update after ticks: end a finished fade, and let standby laws catch up."""
        if self._leaving and self.state.fade_ramp == 0:
            self._end_fade()
        for waiting in self.standby:
            waiting.catch_up()

    def _end_fade(self) -> None:
        self._leaving = []
        self.state.fade_ramp = 0
        self.watched = self._law.watched
        self._store_laws()

    def follow(self, proxy: Proxy, last: int) -> bool:
        """Prepare the histories for a tick after tick `last` (−1: none). Return whether it jumps.

        Missing ticks are bridged. The first deflection, and one after a jump without motion, cause
        no velocity.
        """
        s = self.state
        missing = proxy.seq - last - 1
        if not 0 <= last < proxy.seq:
            last = -1  # the first tick, or the first of a restarted driver
        if last < 0 or proxy.rebased != s.rebased or s.jumps:
            conventions = last >= 0 and s.jumps != 0
            s.rebased = proxy.rebased
            s.jumps = s.field_due = 0
            if self._rebase(proxy, conventions):
                return True
        if last >= 0 and missing > 0:
            self.bridge(proxy, missing)
        return False

    def _rebase(self, proxy: Proxy, conventions: bool) -> bool:
        """Restart the histories at rest at the present deflection. Return whether any changed."""
        s = self.state
        values = deflections(
            s, proxy.position, proxy.proxy, proxy.distance, proxy.normal, proxy.contact
        )
        s.upright[:] = (0.0, 0.0, 0.0)  # a normal that jumped has not turned
        if not conventions and all(
            value == history.values[history.head]
            for value, history in zip(values, self.histories, strict=True)
        ):
            return False
        for n, (value, history) in enumerate(zip(values, self.histories, strict=True)):
            history.fill(value)
            for law in (*self._laws[n], *(waiting.axes[n] for waiting in self.standby)):
                law.settle(value)
        s.ease_ramp = max(proxy.ease or s.ease_usual, 1)
        s.ease_done = 0
        return True

    @property
    def force_step(self) -> float:
        """Force difference at the last jump, within the driver's limit [N]."""
        return math.hypot(*self.state.ease_offset)

    def bridge(self, proxy: Proxy, missing: int) -> None:
        """Fill missing ticks with a straight line to the present one, which is not yet rendered."""
        self._bridge(
            self.state,
            proxy.position,
            proxy.proxy,
            proxy.normal,
            proxy.distance,
            proxy.contact,
            missing,
        )

    def swap(self, law: ActiveLaw, ramp: int) -> float:
        """Make another law active from the next tick on. Return the force step [N].

        Raises ParameterError, and changes nothing, if the law fails.
        """
        law.catch_up()
        if law.watched:
            law.attempt(self.histories)
        s = self.state
        weight = min(s.fade_done / s.fade_ramp, 1.0) if s.fade_ramp else 1.0
        steps = []
        leaving = []
        for n, (before, after) in enumerate(zip(self.law.axes, law.axes, strict=True)):
            shares = shares_of(
                self._leaving[n] if self._leaving else [], before, weight
            )
            steps.append(
                after.present() - sum(share * part.present() for part, share in shares)
            )
            leaving.append(shares)
        step = math.hypot(*steps)
        if not math.isfinite(step):
            raise ParameterError(
                f"law {law.name!r}: a force step of {step} N; its taps are too large for the"
                " present deflection"
            )
        watched = self.watched
        self._leaving = leaving if ramp > 0 else []
        s.fade_ramp = ramp
        s.fade_done = 0
        self.law = law
        # as long as the leaving laws run own code
        self.watched = self.watched or (watched and ramp > 0)
        return step

    def fall_back(self, proxy: Proxy, due: int = 0) -> Vector:
        """Replace a failed law by the fallback in the same tick. Return the force [N]."""
        self._law = self.fallback
        self.name = self.fallback.name
        self._end_fade()
        force = [0.0, 0.0, 0.0]
        met = (
            proxy.position,
            proxy.proxy,
            proxy.normal,
            proxy.distance,
            proxy.contact,
            (proxy.compliance, proxy.stiffness, proxy.damping),
        )
        self._render(self.state, *met, force, due)
        for law in self.standby:
            law.catch_up()
        x, y, z = (value if math.isfinite(value) else 0.0 for value in force)
        return x, y, z

    def snapshots(self) -> list[History]:
        """Return copies of the histories, made from another thread."""
        return [history.snapshot() for history in self.histories]
