"""The coupling node: renders a force for each proxy, and changes laws during contact.

A law is prepared on the control thread (validated, compiled, judged for stability, brought up to
date, tested) and becomes active between two ticks (nodes/coupling/renderer.py); a refused change
leaves the running law untouched. A law that raises, returns a force that is not finite or overruns
its time budget twice within a second is replaced within the same tick.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias

import msgspec

from messages import topics
from messages.types import ZERO, Proxy, Receipt, Vector
from nodes.arithmetic import SMOOTHING
from nodes.base.follow import answer_ticks
from nodes.base.node import Node
from nodes.base.setup import AXIS_INDEX, Axis, Setup, least_delay
from nodes.compiled.layout import NEVER, state_of
from nodes.compiled.published import payload_of
from nodes.coupling.force_fields import ForceField, check_axes, needed_axes
from nodes.coupling.judgement import Judgement, StartAnyway, refuses_start
from nodes.coupling.law_book import LawBook, free_name
from nodes.coupling.law_on_axis import History
from nodes.coupling.parameters import LONGEST_DELAY, CouplingParameters
from nodes.coupling.renderer import ActiveLaw, Renderer, settle_conventions
from nodes.coupling.state import PUBLISHED, CouplingState
from nodes.coupling.time_budget import Budget
from nodes.laws import CompiledLaw
from nodes.laws.parse import parse_law
from nodes.parameters.store import ParameterError, convert

if TYPE_CHECKING:
    from nodes.compiled.answering import CompiledTicks
    from nodes.compiled.library import Kernel
    from nodes.stability.judge import Verdict

# tick, law and ramp [ticks] of a scheduled change
Scheduled: TypeAlias = tuple[int, ActiveLaw, int]
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
        judgement = Judgement(
            setup.name, setup.period, book, setup.plant, setup.effects, setup.axes
        )
        judgement.refuse_contradiction(parameters)
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

    def make_counters(self) -> Any:
        """Return the state."""
        return state_of(
            CouplingState, self.setup.tick == "compiled", seq=-1, answered=-1
        )

    def configure(self) -> None:
        """Compile laws and schedule, and import what later requests need."""
        parameters: CouplingParameters = self.store.current
        self._realtime = self.setup.pace == "realtime"
        self.counters.delay = least_delay(self.setup.apply)
        self._failed_text = ""
        # names of laws that a switch was given by kind and parameters
        self._given_laws: set[str] = set()
        # what was last reported of the law and a world that moves
        self._told_of_world: list[str] = []
        self._book = LawBook(self.setup.name, self.setup.period)
        self._judgement = Judgement(
            self.setup.name,
            self.setup.period,
            self._book,
            self.setup.plant,
            self.setup.effects,
            self.setup.axes,
        )
        self._book.check(parameters)
        axes = [AXIS_INDEX[axis] for axis in self.setup.axes]
        self._renderer = Renderer(axes, parameters.memory, self.counters)
        self.counters.ease_peak = self.setup.peak_force or 0.0
        for reason in self._book.unfit(parameters):
            self.events.emit_each("law", f"{reason}; it cannot become active")
        anyway = StartAnyway.VIRTUAL if self.setup.virtual else StartAnyway.NO_REASON
        if self.resumed_at >= 0:
            anyway = StartAnyway.ACCEPTED_BEFORE
        for text in self._judgement.at_start(parameters, self._felt_delay, anyway):
            self.events.emit_each("stability", text)
        self._told_of_world = self._judgement.of_moving_world(
            parameters, self._felt_delay
        )
        for text in (
            *self._told_of_world,
            *self._judgement.of_effects(parameters),
            *self._judgement.of_field(parameters, self._felt_delay),
        ):
            self.events.emit_each("world", text)
        self._settle(parameters, self._make_fallback(parameters))
        self._renderer.law = self._prepare_law(parameters, parameters.law)
        swaps = [
            (round(swap.at / self.setup.period), swap)
            for swap in sorted(parameters.schedule, key=lambda swap: swap.at)
        ]
        # changes already made before a restart are in the saved parameters
        due = [(tick, swap) for tick, swap in swaps if tick > self.resumed_at]
        for name in dict.fromkeys(
            swap.law for _, swap in due if swap.law != parameters.law
        ):
            # Said now: a scheduled swap comes between two ticks, where nothing is computed.
            for text in self._judgement.of_moving_world(
                parameters, self._felt_delay, name=name
            ):
                self.events.emit_each(
                    "world", f"from the swap that is scheduled: {text}"
                )
        self._take_schedule(
            [
                (tick, self._prepare_law(parameters, swap.law), swap.ramp)
                for tick, swap in due
            ]
        )
        if parameters.figures or parameters.plant is not None:
            # numpy takes tens of milliseconds to import and holds the GIL: now, not during contact
            self._book.figures(
                parameters, self._renderer.law.compiled, self._felt_delay
            )

    def begin_with(
        self, law: CompiledLaw, swaps: Sequence[tuple[int, CompiledLaw, int]]
    ) -> None:
        """Render a compiled law from the start, and swap to others at given ticks.

        `swaps` are tick, law and ramp [ticks], in the order of their ticks.
        """
        histories = self._renderer.histories
        self._renderer.law = ActiveLaw("given", "", law, histories)
        self._take_schedule(
            [
                (tick, ActiveLaw(f"given_{n}", "", later, histories), ramp)
                for n, (tick, later, ramp) in enumerate(swaps, 1)
            ]
        )

    def _take_schedule(self, schedule: list[Scheduled]) -> None:
        self._schedule = schedule
        if self._realtime:
            # Replaying the history at the change would take longer than a tick. In lockstep nobody
            # waits, and the one-process scene replays it too.
            self._renderer.standby = [
                law for _, law, _ in schedule if law.compiled.sections
            ]

    def _changed_schedule(
        self, now: CouplingParameters, parameters: CouplingParameters, force: bool
    ) -> list[Scheduled]:
        """Return the schedule, with the changed laws compiled again."""
        changed = []
        for tick, law, ramp in list(self._schedule):
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
                self._judge(now, parameters, fresh, force)
            if is_changed:
                fresh.warm_up(self._renderer.snapshots())
            changed.append((tick, fresh, ramp))
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

    @property
    def _felt_delay(self) -> float:
        """Delay of the loop as measured so far, limited for judging [ticks]; from any thread."""
        return min(float(self.counters.delay), LONGEST_DELAY)

    def _judge(
        self,
        now: CouplingParameters,
        wanted: CouplingParameters,
        law: ActiveLaw,
        force: bool,
    ) -> dict[str, Any]:
        """Return the stability figures before and after a change; reject an unstable one."""
        verdict, warning = self._judgement.of_change(
            now, wanted, law.name, law.compiled, self._felt_delay, force
        )
        if warning:
            self.events.emit_each("stability", warning)
        before = self._judgement.verdict(
            now, self._renderer.law.compiled, self._felt_delay
        )
        return self._judged(law.name, wanted, verdict, before)

    def _judge_moving(
        self, wanted: CouplingParameters, law: ActiveLaw
    ) -> dict[str, Any]:
        """Return a receipt's text about a law and a moving world, and report changes of it."""
        told = self._judgement.of_moving_world(
            wanted, self._felt_delay, law.compiled, law.name
        )
        if told and told != self._told_of_world:
            for text in told:
                self.events.emit_each("world", text)
        self._told_of_world = told
        return {"world": told} if told else {}

    def _judged(
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

    def _judge_set_aside(
        self, now: CouplingParameters, wanted: CouplingParameters, force: bool
    ) -> dict[str, Any]:
        """Judge the changed laws that do not render. Return the figures of the last, or none."""
        figures: dict[str, Any] = {}
        for name, law in wanted.laws.items():
            if law == now.laws.get(name):
                continue
            compiled = self._book.compile(wanted, name)
            if name == wanted.law or any(
                scheduled.name == name for _, scheduled, _ in self._schedule
            ):
                continue  # judged with what renders
            verdict, warning = self._judgement.of_change(
                now, wanted, name, compiled, self._felt_delay, force
            )
            if warning:
                self.events.emit_each("stability", warning)
            figures = self._judged(name, wanted, verdict, self._before(now, name))
        return figures

    def _before(self, now: CouplingParameters, name: str) -> Verdict | None:
        """Return the verdict on a law as it was before a change, on the plant of then; or None."""
        # no law of that name, or too long to render
        with contextlib.suppress(ParameterError):
            return self._judgement.verdict(
                now, self._book.compile(now, name), self._felt_delay
            )
        return None

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
        action = action or ("set" if parameters.law == now.law else "switch")
        ramp = parameters.ramp if ramp is None else ramp
        self._book.refuse_fixed(now, parameters)
        _check_frame(parameters, self.setup)
        check_axes(parameters.field, self.setup.axes, f"{self.setup.name}.field")
        if not force:
            self._judgement.refuse_contradiction(parameters, now)
        set_aside = self._judge_set_aside(now, parameters, force)
        fallback = self._make_fallback(parameters)
        self._judgement.refuse_fallback(now, parameters, self._felt_delay, force)
        law = self._prepare_law(parameters, parameters.law)
        judged = law.compiled, parameters.plant, parameters.field, parameters.stability
        before = self._renderer.law.compiled, now.plant, now.field, now.stability
        stability: dict[str, Any] = {"stability": set_aside} if set_aside else {}
        if judged != before:
            stability = {"stability": self._judge(now, parameters, law, force)}
            stability |= self._judge_moving(parameters, law)
        if parameters.field != now.field:
            told = self._judgement.of_field(parameters, self._felt_delay, law.compiled)
            stability["world"] = [*stability.get("world", ()), *told]
        if action == "set" and law.text == self._failed_text:
            # A failed law does not return because another parameter is set; switching to it by name
            # does it.
            law = fallback
        self._bring_up(law, parameters)
        schedule = self._changed_schedule(now, parameters, force)

        def apply(seq: int) -> dict[str, Any]:
            receipt = {**self._swap(seq, law, ramp, action, "asked"), **stability}
            self._settle(parameters, fallback)
            self._take_schedule(schedule)
            return receipt

        return apply

    def operations(self) -> dict[str, Callable[..., Any]]:
        """Return the law operations."""
        return {
            "law.list": self._list_laws,
            "law.show": self._show_law,
            "law.switch": self._switch_law,
            "progress": lambda: {"law": self._renderer.law.name},
        }

    def _list_laws(self) -> dict[str, Any]:
        parameters: CouplingParameters = self.store.current
        laws = {
            name: self._book.description(parameters, name)
            for name in self._book.names(parameters)
        }
        return {"active": self._renderer.law.name, "laws": laws}

    def _show_law(self, law: str = "") -> dict[str, Any]:
        parameters: CouplingParameters = self.store.current
        plant = (
            {}
            if parameters.plant is None
            else {"plant": msgspec.to_builtins(parameters.plant)}
        )
        if law:
            described = self._book.description(parameters, law)
            return {
                "law": law,
                **described,
                **plant,
                **self._book.figures(parameters, law, self._felt_delay),
            }
        active = self._renderer.law
        described = msgspec.json.decode(active.text)
        return {
            **described,
            **plant,
            **self._book.figures(parameters, active.compiled, self._felt_delay),
        }

    def _switch_law(
        self, law: Any, ramp: int | None = None, force: bool = False
    ) -> dict[str, Any]:
        """Switch to a law by name, or to one that is given by kind and parameters."""
        usual = self.store.current.ramp
        wanted: dict[str, Any] = {} if ramp is None else {"ramp": ramp}
        if isinstance(law, Mapping):
            law, description = self._named(law), law
            wanted[f"laws.{law}"] = dict(description)
        wanted["law"] = law
        before = self._renderer.law
        ramps = []

        def make() -> Any:
            changed: CouplingParameters = self.store.changed(wanted)
            ramps.append(changed.ramp)
            return msgspec.structs.replace(changed, ramp=usual)

        change = self.changes.change
        receipt: dict[str, Any] = change(
            make, lambda wanted: self.prepare(wanted, "switch", ramps[-1], bool(force))
        )
        parameters: CouplingParameters = self.store.current
        if parameters.figures:
            receipt["was"] = self._book.figures(
                parameters, before.compiled, self._felt_delay
            )
            receipt["is"] = self._book.figures(parameters, law, self._felt_delay)
        return receipt

    def _named(self, law: Mapping[str, Any]) -> str:
        """Return a name for a law given by kind and parameters; raises LawRefusedError.

        Names of such laws that no longer render are used again, so that a program may switch
        without end.
        """
        parse_law(law, f"{self.setup.name}.law")
        parameters: CouplingParameters = self.store.current
        needed = {parameters.law, *(later.name for _, later, _ in self._schedule)}
        name = free_name(law, parameters.laws, self._given_laws - needed)
        if name not in parameters.laws:
            self._given_laws.add(name)
        return name

    @property
    def rendering(self) -> Renderer:
        """What renders, and what it remembers."""
        return self._renderer

    # -- between two ticks --

    def _swap(
        self, seq: int, law: ActiveLaw, ramp: int, action: str, reason: str
    ) -> dict[str, Any]:
        old = self._renderer.law
        force_step = self._renderer.swap(law, ramp)
        self._failed_text = self._failed_text if law.name == "fallback" else ""
        self._file_receipt(seq, action, old, law, reason, force_step, ramp)
        told = {
            "from": old.name,
            "to": law.name,
            "force_step_n": force_step,
            "ramp": ramp,
            "revision": self.counters.revision,
        }
        return {"seq": seq, "action": action, **told}

    def _file_receipt(
        self,
        seq: int,
        action: str,
        old: ActiveLaw,
        new: ActiveLaw,
        reason: str,
        force_step: float = 0.0,
        ramp: int = 0,
    ) -> None:
        self.counters.revision += 1
        told: dict[str, Any] = {
            "before": old.text,
            "after": new.text,
            "force_step": force_step,
            "ramp": ramp,
        }
        stamp = self.clock.now()
        revision = self.counters.revision
        receipt = Receipt(
            seq=seq,
            stamp=stamp,
            action=action,
            reason=reason[:4000],
            revision=revision,
            **told,
        )
        self.events.publish(self.setup.topic(topics.RECEIPT), receipt)

    def _follow_schedule(self, seq: int) -> None:
        while self._schedule and self._schedule[0][0] <= seq:
            _, law, ramp = self._schedule.pop(0)
            if law in self._renderer.standby:
                self._renderer.standby.remove(law)
            else:
                law.warm_up(self._renderer.histories)
            try:
                self._swap(seq, law, ramp, "switch", "schedule")
            except ParameterError as error:
                self.events.emit_each(
                    "refused",
                    f"scheduled swap at tick {seq}: {error}; the running law continues",
                )
            else:
                self.store.accept(
                    msgspec.structs.replace(self.store.current, law=law.name)
                )

    def next_swap(self) -> int:
        """Return the tick of the next scheduled change, or NEVER."""
        return self._schedule[0][0] if self._schedule else NEVER

    def compiled_ticks(self, kernel: Kernel) -> CompiledTicks:
        """Return the compiled ticks."""
        from nodes.coupling.compiled_tick import CouplingTicks

        return CouplingTicks(self, kernel, self._renderer)

    # -- the tick --

    def _fall_back(self, proxy: Proxy, reason: str, due: int = 0) -> Vector:
        failed = self._renderer.law
        if not failed.watched and due:
            reason = f"a law that was fading out {reason}"
        force = self._renderer.fall_back(proxy, due)
        self._failed_text = failed.text
        self._file_receipt(proxy.seq, "fallback", failed, self._renderer.law, reason)
        text = f"law {failed.name!r} at tick {proxy.seq}: {reason}; the fallback renders now"
        self.events.emit_each("fallback", text, {"tick": proxy.seq})
        return force

    def _watched(self, proxy: Proxy) -> Vector:
        """Render with a law that has own code, which may raise or take too long."""
        due = self._renderer.due()
        served = self.changes.serving.seconds()
        self._budget.start()
        try:
            force = self._renderer.render(proxy)
        except Exception as error:  # noqa: BLE001  # a law from another package may raise anything
            return self._fall_back(
                proxy, f"raised {type(error).__name__}: {error}", due
            )
        over = self._budget.overrun(excused=self.changes.serving.seconds() - served)
        if not over:
            return force
        if self._budget.again(proxy.seq * self.setup.period):
            return self._fall_back(proxy, over)
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
        if self._schedule:
            self._follow_schedule(seq)
        s.delay += (proxy.delay - s.delay) * SMOOTHING
        force = self._watched(proxy) if renderer.watched else renderer.render(proxy)
        if not math.isfinite(force[0] + force[1] + force[2]):
            force = self._fall_back(
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
