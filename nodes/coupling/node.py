"""The coupling node: renders a force for each proxy, and changes laws during contact.

A law is prepared on the control thread (validated, compiled, judged for stability, brought up to
date, tested) and becomes active between two ticks (nodes/coupling/renderer.py); a refused change
leaves the running law untouched. A law that raises, returns a force that is not finite or overruns
its time budget twice within a second is replaced within the same tick.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import msgspec

from messages import topics
from messages.types import ZERO, Proxy, Vector
from nodes.arithmetic import SMOOTHING
from nodes.base.follow import answer_ticks
from nodes.base.node import Node
from nodes.base.setup import AXIS_INDEX, Axis, Setup, least_delay
from nodes.compiled.layout import state_of
from nodes.compiled.published import payload_of
from nodes.coupling.contradictions import refuse_contradiction
from nodes.coupling.force_fields import ForceField, check_axes, needed_axes
from nodes.coupling.judgement import Judgement, StartAnyway, refuses_start
from nodes.coupling.law_book import LawBook
from nodes.coupling.law_on_axis import History
from nodes.coupling.law_operations import LawOperations
from nodes.coupling.law_swaps import LawSwaps
from nodes.coupling.live_judgement import LiveJudgement
from nodes.coupling.parameters import CouplingParameters
from nodes.coupling.renderer import ActiveLaw, Renderer, settle_conventions
from nodes.coupling.state import PUBLISHED, CouplingState
from nodes.coupling.swap_schedule import ScheduledSwap, SwapSchedule
from nodes.coupling.time_budget import Budget
from nodes.laws import CompiledLaw
from nodes.parameters.store import ParameterError, convert

if TYPE_CHECKING:
    from nodes.compiled.answering import CompiledTicks
    from nodes.compiled.library import Kernel

ATTEMPTS = 5  # tests of a law's own code before it counts as too slow

_payload = payload_of(PUBLISHED)


def _check_frame(parameters: CouplingParameters, setup: Setup) -> None:
    if parameters.frame == "surface" and len(setup.axes) < 3:
        raise ParameterError(
            "surface turns the history in space, but run.axes is"
            f" [{', '.join(setup.axes)}]; take world, or name all three axes",
            path=f"{setup.name}.frame",
        )


class Coupling(Node):
    """Answers proxies with forces."""

    Parameters: ClassVar[type[msgspec.Struct]] = CouplingParameters
    publishes: ClassVar[tuple[str, ...]] = (topics.FORCE, topics.RECEIPT)
    listens_to: ClassVar[tuple[str, ...]] = (topics.PROXY,)
    answers: ClassVar[bool] = True
    kernel_module: ClassVar[str] = "nodes.coupling.kernel"

    counters: CouplingState

    @classmethod
    def check(cls, setup: Setup) -> None:
        """Parse every law, and compile those that will render, before the launch."""
        parameters: CouplingParameters = convert(
            setup.parameters, CouplingParameters, setup.name
        )
        book = LawBook(setup.name, setup.period)
        book.check(parameters)
        _check_frame(parameters, setup)
        check_axes(parameters.field, setup.axes, f"{setup.name}.field")
        judgement = Judgement(setup.name, setup.period, book, setup.effects, setup.axes)
        refuse_contradiction(setup.name, setup.plant, parameters)
        reason = StartAnyway.VIRTUAL if setup.virtual else StartAnyway.NO_REASON
        if refuses_start(parameters.stability, reason):
            judgement.at_start(parameters, least_delay(setup.apply), reason)

    @classmethod
    def axes(cls, parameters: Mapping[str, Any], name: str) -> tuple[Axis, ...]:
        """Return the axes that a field needs."""
        if "field" not in parameters:
            return ()
        return needed_axes(convert(parameters["field"], ForceField, f"{name}.field"))

    @classmethod
    def unjudged(cls, setup: Setup) -> str:
        """Return why a law that will render is not judged."""
        book = LawBook(setup.name, setup.period)
        return Judgement(setup.name, setup.period, book).unjudged(
            convert(setup.parameters, CouplingParameters, setup.name)
        )

    # -- off the hot path --

    def make_counters(self) -> CouplingState:
        """Return the state."""
        return state_of(
            CouplingState, self.setup.tick == "compiled", seq=-1, answered=-1
        )

    def configure(self) -> None:
        """Compile laws and schedule, and import what later requests need."""
        parameters: CouplingParameters = self.store.current
        self._realtime = self.setup.pace == "realtime"
        self.counters.delay = least_delay(self.setup.apply)
        self._book = LawBook(self.setup.name, self.setup.period)
        self._judgement = Judgement(
            self.setup.name,
            self.setup.period,
            self._book,
            self.setup.effects,
            self.setup.axes,
        )
        self._book.check(parameters)
        axes = [AXIS_INDEX[axis] for axis in self.setup.axes]
        self._renderer = Renderer(axes, parameters.memory, self.counters)
        self._schedule = SwapSchedule(self._renderer, ahead=self._realtime)
        self._swaps = LawSwaps(self, self._renderer, self._schedule)
        live = LiveJudgement(self._judgement, self._book, self._renderer, self.events)
        self._live = live
        self._laws = LawOperations(
            self, self._book, self._renderer, self._schedule, live
        )
        self.counters.ease_peak = self.setup.peak_force or 0.0
        for reason in self._book.unfit(parameters):
            self.events.emit_each("law", f"{reason}; it cannot become active")
        anyway = StartAnyway.VIRTUAL if self.setup.virtual else StartAnyway.NO_REASON
        if self.resumed_at >= 0:
            anyway = StartAnyway.ACCEPTED_BEFORE
        live.report_start(parameters, anyway)
        self._settle(parameters, self._make_fallback(parameters))
        self._renderer.law = self._prepare_law(parameters, parameters.law)
        swaps = [
            (round(swap.at / self.setup.period), swap)
            for swap in sorted(parameters.schedule, key=lambda swap: swap.at)
        ]
        # changes already made before a restart are in the saved parameters
        due = [(tick, swap) for tick, swap in swaps if tick > self.resumed_at]
        others = dict.fromkeys(
            swap.law for _, swap in due if swap.law != parameters.law
        )
        live.report_scheduled(parameters, others)
        self._schedule.replace(
            [
                ScheduledSwap(tick, self._prepare_law(parameters, swap.law), swap.ramp)
                for tick, swap in due
            ]
        )
        if parameters.figures or parameters.plant is not None:
            # numpy takes tens of milliseconds to import and holds the GIL: now, not during contact
            self._book.figures(parameters, self._renderer.law.compiled, live.delay)

    def begin_with(
        self, law: CompiledLaw, swaps: Sequence[tuple[int, CompiledLaw, int]]
    ) -> None:
        """Render a compiled law from the start, and swap to others at given ticks.

        `swaps` are tick, law and ramp [ticks], in the order of their ticks.
        """
        histories = self._renderer.histories
        self._renderer.law = ActiveLaw("given", "", law, histories)
        self._schedule.replace(
            [
                ScheduledSwap(tick, ActiveLaw(f"given_{n}", "", later, histories), ramp)
                for n, (tick, later, ramp) in enumerate(swaps, 1)
            ]
        )

    def _changed_schedule(
        self, now: CouplingParameters, parameters: CouplingParameters, force: bool
    ) -> list[ScheduledSwap]:
        """Return the schedule, with the changed laws compiled again."""
        changed = []
        for tick, law, ramp in list(self._schedule.swaps):
            fresh = law
            is_changed = self._book.description(
                parameters, law.name
            ) != self._book.description(now, law.name)
            if is_changed:
                fresh = self._prepare_law(parameters, law.name)
            if is_changed or (parameters.plant, parameters.field) != (
                now.plant,
                now.field,
            ):
                self._live.of_change(now, parameters, fresh, force)
            if is_changed:
                fresh.warm_up(self._renderer.snapshots())
            changed.append(ScheduledSwap(tick, fresh, ramp))
        return changed

    def _settle(self, parameters: CouplingParameters, fallback: ActiveLaw) -> None:
        settle_conventions(self.counters, parameters, self.setup.period)
        self._renderer.fallback = fallback
        self._budget = self._budget_of(parameters)

    def _make_fallback(self, parameters: CouplingParameters) -> ActiveLaw:
        compiled = parameters.fallback.compile(self.setup.period)
        text = f'{{"law":"fallback","damping":{parameters.fallback.damping!r}}}'
        return ActiveLaw("fallback", text, compiled, self._renderer.histories)

    def _prepare_law(self, parameters: CouplingParameters, name: str) -> ActiveLaw:
        compiled = self._book.compile(parameters, name)
        return ActiveLaw(
            name, self._book.text(parameters, name), compiled, self._renderer.histories
        )

    def _bring_up(self, law: ActiveLaw, parameters: CouplingParameters) -> None:
        """Update the law's sections from the history, and test its own code, on copies."""
        snapshots = self._renderer.snapshots()
        law.warm_up(snapshots)
        if law.watched:
            self._try_out(law, snapshots, self._budget_of(parameters))

    def _budget_of(self, parameters: CouplingParameters) -> Budget:
        return Budget(
            parameters.budget * self.setup.period if self._realtime else math.inf
        )

    def _try_out(
        self, law: ActiveLaw, snapshots: list[History], budget: Budget
    ) -> None:
        over = ""
        # This thread is less urgent than the loop's: only a law that is never in time is too slow.
        for _ in range(ATTEMPTS):
            budget.start()
            law.attempt(snapshots)
            over = budget.overrun()
            if not over:
                return
        raise ParameterError(
            f"law {law.name!r}: {over}; raise {self.setup.name}.budget or choose another law"
        )

    def prepare_forced(self, parameters: Any) -> Callable[[int], Any]:
        """Prepare changed parameters even if they make the loop unstable."""
        return self.prepare(parameters, force=True)

    def prepare(
        self,
        parameters: Any,
        action: str = "",
        ramp: int | None = None,
        force: bool = False,
    ) -> Callable[[int], Any]:
        """Prepare changed parameters: compile the active law and reject fixed ones."""
        now: CouplingParameters = self.store.current
        delay = self._live.delay
        action = action or ("set" if parameters.law == now.law else "switch")
        ramp = parameters.ramp if ramp is None else ramp
        self._book.refuse_fixed(now, parameters)
        _check_frame(parameters, self.setup)
        check_axes(parameters.field, self.setup.axes, f"{self.setup.name}.field")
        if not force:
            refuse_contradiction(self.setup.name, self.setup.plant, parameters, now)
        set_aside = self._live.of_set_aside(
            now, parameters, self._schedule.names, force
        )
        fallback = self._make_fallback(parameters)
        self._judgement.refuse_fallback(now, parameters, delay, force)
        law = self._prepare_law(parameters, parameters.law)
        judged = law.compiled, parameters.plant, parameters.field, parameters.stability
        before = self._renderer.law.compiled, now.plant, now.field, now.stability
        stability: dict[str, Any] = {"stability": set_aside} if set_aside else {}
        if judged != before:
            stability = {"stability": self._live.of_change(now, parameters, law, force)}
            stability |= self._live.of_moving_world(parameters, law)
        if parameters.field != now.field:
            told = self._judgement.of_field(parameters, delay, law.compiled)
            stability["world"] = [*stability.get("world", ()), *told]
        if action == "set" and law.text == self._swaps.failed_text:
            # A failed law does not return because another parameter is set; switching to it by name
            # does it.
            law = fallback
        self._bring_up(law, parameters)
        schedule = self._changed_schedule(now, parameters, force)

        def apply(seq: int) -> dict[str, Any]:
            receipt = {**self._swaps.swap(seq, law, ramp, action, "asked"), **stability}
            self._settle(parameters, fallback)
            self._schedule.replace(schedule)
            return receipt

        return apply

    def check_health(self) -> None:
        """Note the loop's delay, by which refusals suggest values."""
        self._live.note_delay()

    def operations(self) -> dict[str, Callable[..., Any]]:
        """Return the law operations."""
        return {
            "law.list": self._laws.list,
            "law.show": self._laws.show,
            "law.switch": self._switch_law,
            "progress": lambda: {"law": self._renderer.law.name},
        }

    def _switch_law(
        self, law: Any, ramp: int | None = None, force: bool = False
    ) -> dict[str, Any]:
        return self._laws.switch(
            law,
            ramp,
            lambda wanted, ramp: self.prepare(wanted, "switch", ramp, bool(force)),
        )

    @property
    def rendering(self) -> Renderer:
        """What renders, and what it remembers."""
        return self._renderer

    def compiled_ticks(self, kernel: Kernel) -> CompiledTicks[CouplingState]:
        """Return the compiled ticks."""
        from nodes.coupling.compiled_tick import CouplingTicks

        return CouplingTicks(self, kernel, self._renderer, self._schedule)

    # -- the tick --

    def _watched(self, proxy: Proxy) -> Vector:
        """Render with a law that has own code, which may raise or take too long."""
        due = self._renderer.due()
        served = self.changes.serving.seconds()
        self._budget.start()
        try:
            force = self._renderer.render(proxy)
        except Exception as error:  # noqa: BLE001  # a law from another package may raise anything
            return self._swaps.fall_back(
                proxy, f"raised {type(error).__name__}: {error}", due
            )
        over = self._budget.overrun(excused=self.changes.serving.seconds() - served)
        if not over:
            return force
        if self._budget.again(proxy.seq * self.setup.period):
            return self._swaps.fall_back(proxy, over)
        self.events.emit(
            "budget",
            f"law {self._renderer.name!r} at tick {proxy.seq}: {over}; another overrun within "
            "a second activates the fallback",
            {"tick": proxy.seq},
        )
        return force

    def _report_jump(self, proxy: Proxy) -> None:
        """Report the force step of a jump."""
        step = self._renderer.force_step
        ramp = proxy.ease or self.counters.ease_usual
        if step > 0.0:
            began = self.counters.answered < 0
            what = (
                "the loop begins in contact"
                if began
                else "position, surface or proxy jumped without motion"
            )
            how = (
                f"eased over {ramp * self.setup.period:.3g} s"
                if ramp > 1
                else "at once: ease is 0"
            )
            text = f"tick {proxy.seq}: {what}: a force step of {step:.4g} N, {how}"
            seconds = ramp * self.setup.period if ramp > 1 else 0.0
            self.events.emit_each(
                "eased",
                text,
                {"tick": proxy.seq, "force_step_n": step, "ramp_s": seconds},
            )

    def respond(self, proxy: Proxy) -> bytes:
        """Answer a tick's proxy with a force."""
        seq, s, renderer = proxy.seq, self.counters, self._renderer
        jumped = renderer.follow(proxy, s.answered)
        if self._schedule.swaps:
            self._swaps.follow_schedule(seq)
        s.delay += (proxy.delay - s.delay) * SMOOTHING
        force = self._watched(proxy) if renderer.watched else renderer.render(proxy)
        if not math.isfinite(force[0] + force[1] + force[2]):
            force = self._swaps.fall_back(
                proxy, f"returned a force that is not finite: {force}"
            )
        if jumped:
            self._report_jump(proxy)
        s.stamp = proxy.stamp if self.clock.simulated else self.clock.now()
        s.seq = seq
        s.credit = proxy.credit
        s.force[:] = force
        s.normal[:] = proxy.normal if proxy.contact else ZERO
        return _payload(s, renderer.name)

    def loop(self) -> None:
        """Answer proxies until stopped."""
        answer_ticks(self, Proxy, topics.PROXY, topics.FORCE, self.respond)
