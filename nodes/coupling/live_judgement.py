"""Judgement of a running coupling's laws: warnings become events, figures enter receipts.

All of this runs on the control thread, or before the first tick.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Collection, Iterable
from typing import TYPE_CHECKING, Any

from nodes.base.events import Events
from nodes.coupling.judgement import Judgement, StartAnyway
from nodes.coupling.law_book import LawBook
from nodes.coupling.likely_delays import LikelyDelays
from nodes.coupling.parameters import LONGEST_DELAY, CouplingParameters
from nodes.coupling.renderer import ActiveLaw, Renderer
from nodes.laws import CompiledLaw
from nodes.laws.parse import LawRefusedError
from nodes.parameters.store import ParameterError

if TYPE_CHECKING:
    from nodes.stability.judge import Verdict


class LiveJudgement:
    """Judges laws at the measured delay, and reports on the node's `events`."""

    def __init__(
        self, judgement: Judgement, book: LawBook, renderer: Renderer, events: Events
    ) -> None:
        self._judgement, self._book = judgement, book
        self._renderer, self._events = renderer, events
        # what was last reported of the law and a world that moves
        self._of_world: list[str] = []
        self._likely = LikelyDelays()

    @property
    def delay(self) -> float:
        """Delay of the loop as measured so far, limited for judging [ticks]; from any thread."""
        return min(float(self._renderer.state.delay), LONGEST_DELAY)

    def note_delay(self) -> None:
        """Note the measured delay, for what refusals suggest; called a few times a second."""
        self._likely.add(time.monotonic(), self.delay)

    def report_start(self, parameters: CouplingParameters, reason: StartAnyway) -> None:
        """Judge the laws of a start, and report what the world makes of the law of tick 0."""
        judgement, delay = self._judgement, self.delay
        for text in judgement.at_start(parameters, delay, reason):
            self._events.emit_each("stability", text)
        self._of_world = judgement.of_moving_world(parameters, delay)
        for text in (
            *self._of_world,
            *judgement.of_effects(parameters),
            *judgement.of_field(parameters, delay),
        ):
            self._events.emit_each("world", text)

    def report_scheduled(
        self, parameters: CouplingParameters, names: Iterable[str]
    ) -> None:
        """Report what a moving world makes of laws that are scheduled.

        Reported at the start, because a swap comes between two ticks, where nothing is computed.
        """
        for name in names:
            for text in self._judgement.of_moving_world(
                parameters, self.delay, name=name
            ):
                self._events.emit_each(
                    "world", f"from the swap that is scheduled: {text}"
                )

    def of_change(
        self,
        now: CouplingParameters,
        wanted: CouplingParameters,
        law: ActiveLaw,
        force: bool,
    ) -> dict[str, Any]:
        """Return the stability figures before and after a change; reject an unstable one."""
        verdict = self._verdict(now, wanted, law.name, law.compiled, force)
        before = self._judgement.verdict(now, self._renderer.law.compiled, self.delay)
        return self._figures(law.name, wanted, verdict, before)

    def of_moving_world(
        self, wanted: CouplingParameters, law: ActiveLaw
    ) -> dict[str, Any]:
        """Return a receipt's text about a law and a moving world, and report changes of it."""
        texts = self._judgement.of_moving_world(
            wanted, self.delay, law.compiled, law.name
        )
        if texts and texts != self._of_world:
            for text in texts:
                self._events.emit_each("world", text)
        self._of_world = texts
        return {"world": texts} if texts else {}

    def of_set_aside(
        self,
        now: CouplingParameters,
        wanted: CouplingParameters,
        scheduled: Collection[str],
        force: bool,
    ) -> dict[str, Any]:
        """Judge the changed laws that do not render. Return the figures of the last, or none.

        The active law and `scheduled` ones are judged with what renders.
        """
        figures: dict[str, Any] = {}
        for name, description in wanted.laws.items():
            if description == now.laws.get(name):
                continue
            compiled = self._compiled(now, wanted, name, force)
            if name == wanted.law or name in scheduled:
                continue
            verdict = self._verdict(now, wanted, name, compiled, force)
            figures = self._figures(name, wanted, verdict, self._before(now, name))
        return figures

    def _compiled(
        self,
        now: CouplingParameters,
        wanted: CouplingParameters,
        name: str,
        force: bool,
    ) -> CompiledLaw:
        """Return a changed law, compiled; a refusal suggests what is accepted at once."""
        try:
            return self._book.compile(wanted, name)
        except LawRefusedError as error:
            self._judgement.replace_remedies(
                error, now, wanted, name, force, self._likely_delays()
            )
            raise

    def _likely_delays(self) -> list[float]:
        """Return delays at which a suggested value may be judged a moment later [ticks]."""
        delay = self.delay
        self._likely.add(time.monotonic(), delay)
        return [min(one, LONGEST_DELAY) for one in self._likely.around(delay)]

    def _verdict(
        self,
        now: CouplingParameters,
        wanted: CouplingParameters,
        name: str,
        law: CompiledLaw,
        force: bool,
    ) -> Verdict | None:
        """Return the verdict on a changed law, and report its warning; reject an unstable one."""
        verdict, warning = self._judgement.of_change(
            now, wanted, name, law, self.delay, force, self._likely_delays()
        )
        if warning:
            self._events.emit_each("stability", warning)
        return verdict

    def _before(self, now: CouplingParameters, name: str) -> Verdict | None:
        """Return the verdict on a law as it was before a change, on the plant of then; or None."""
        # no law of that name, or too long to render
        with contextlib.suppress(ParameterError):
            return self._judgement.verdict(
                now, self._book.compile(now, name), self.delay
            )
        return None

    def _figures(
        self,
        law: str,
        wanted: CouplingParameters,
        verdict: Verdict | None,
        before: Verdict | None,
    ) -> dict[str, Any]:
        """Return a law's stability for a receipt."""
        return {
            "law": law,
            "pole_radius": verdict and verdict.pole_radius,
            "was_pole_radius": before and before.pole_radius,
            "delay_ticks": verdict and verdict.plant.delay,
            "stable": verdict and verdict.stable,
            "why": "" if verdict else self._judgement.why_not(wanted),
        }
