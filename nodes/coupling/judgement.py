"""Stability checks of laws before they render; a refusal names an accepted value.

All of this runs on the control thread, or before the launch.
"""

from __future__ import annotations

import enum
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from messages.errors import FORCE, OTHER, Remedy
from nodes.base.setup import AXIS_INDEX, Effect
from nodes.coupling.felt_law import effective, felt_laws
from nodes.coupling.field_judgement import (
    FeltLaw,
    field_text,
    unjudged_field,
    worst_in_field,
)
from nodes.coupling.law_book import LawBook
from nodes.coupling.parameters import CouplingParameters
from nodes.coupling.remedies import Accepts, Remedies
from nodes.laws import CompiledLaw
from nodes.laws.parse import LawRefusedError
from nodes.parameters.interface_words import COMMAND_LINE
from nodes.parameters.store import ParameterError

if TYPE_CHECKING:
    from nodes.stability.judge import Verdict
    from nodes.stability.plant import Plant


class StartAnyway(enum.Enum):
    """Why a coupling may start with a law that would be refused as a change."""

    NO_REASON = ""
    VIRTUAL = "the device is virtual and its driver stops an unstable loop"
    ACCEPTED_BEFORE = "it was accepted before the restart"


def refuses_start(policy: str, reason: StartAnyway) -> bool:
    """Return whether a coupling refuses to start with an unstable law.

    A law that was accepted before a restart is accepted again, because the run would have no law
    otherwise.
    """
    if reason is StartAnyway.ACCEPTED_BEFORE:
        return False
    return policy == "refuse" or (
        policy == "changes" and reason is StartAnyway.NO_REASON
    )


class Judgement:
    """Judges the laws of one coupling.

    Parameters
    ----------
    node : str
        Name of the coupling.
    period : float
        Sampling period T [s].
    book : LawBook
        Its laws.
    effects : sequence of Effect
        What shapes and regions of the environment make of a law; it is judged as each of them.
    axes : sequence of str
        Axes that the scene computes, along which a field acts.
    """

    def __init__(
        self,
        node: str,
        period: float,
        book: LawBook,
        effects: Sequence[Effect] = (),
        axes: Sequence[str] = tuple(AXIS_INDEX),
    ) -> None:
        self._node = node
        self._period = period
        self._book = book
        self._effects = effects
        self._axes = axes
        self._remedies = Remedies(node, period, book)

    def verdict(
        self, parameters: CouplingParameters, law: CompiledLaw, measured_delay: float
    ) -> Verdict | None:
        """Return the verdict on a compiled law with the declared device, at its worst mass.

        What a shape or region makes of it counts where it is unstable and the law itself is not.
        """
        if parameters.plant is None or parameters.stability == "off":
            return None
        from nodes.stability.judge import judge

        plants = parameters.plant.over_workspace(self._period, measured_delay)
        found = [judge(law, plant) for plant in plants]
        worst = max(filter(None, found), key=lambda one: one.pole_radius, default=None)
        if worst is None or not worst.stable:
            return worst
        for effect in self._effects:
            for felt, springless in self._felt_as(law, effect):
                for plant in plants:
                    verdict = judge(felt, plant, springless)
                    if verdict is not None and not verdict.stable:
                        return replace(verdict, felt=effect.name)
        in_field = worst_in_field(
            self._felt(law), plants, parameters.field, self._axes, self._field
        )
        return in_field if in_field is not None and not in_field.stable else worst

    @property
    def _field(self) -> str:
        return f"{self._node}.field"

    def _felt_as(self, law: CompiledLaw, effect: Effect) -> list[FeltLaw]:
        """Return the laws that an effect makes of a law."""
        springless = effect.lag > 0.0 and not effect.line
        return [(felt, springless) for felt in felt_laws(law, effect, self._period)]

    def _felt(self, law: CompiledLaw) -> list[FeltLaw]:
        """Return a law, and the laws that all effects make of it."""
        if law.evaluate is not None:
            return []
        return [(law, False)] + [
            felt for effect in self._effects for felt in self._felt_as(law, effect)
        ]

    def of_field(
        self,
        parameters: CouplingParameters,
        delay: float,
        law: CompiledLaw | None = None,
    ) -> list[str]:
        """Return what a field makes of the law of tick 0, or of another one; none without.

        `delay`: measured delay of the loop [ticks].
        """
        law = self._book.compile(parameters, parameters.law) if law is None else law
        texts = [field_text(parameters.field, law, self._period, self._axes)]
        why = self._unjudged_field(parameters, [(parameters.law, law)])
        if why:
            texts.append(f"not judged: {why}")
        elif parameters.plant is not None and parameters.stability != "off":
            plants = parameters.plant.over_workspace(self._period, delay)
            worst = worst_in_field(
                self._felt(law), plants, parameters.field, self._axes, self._field
            )
            if worst is not None:
                motion = worst.felt.partition(", ")[2]
                texts.append(f"worst pole radius {worst.pole_radius:.6g}, {motion}")
        return [f"{self._field}: {'; '.join(texts)}"] if texts[0] else []

    def _unjudged_field(
        self, parameters: CouplingParameters, laws: Iterable[tuple[str, CompiledLaw]]
    ) -> str:
        plant = parameters.plant
        moves = plant is not None and (
            plant.tool_mass is not None
            or plant.tool_lag is not None
            or plant.partner_mass is not None
        )
        return unjudged_field(parameters.field, laws, moves, self._field)

    def of_effects(
        self, parameters: CouplingParameters, law: CompiledLaw | None = None
    ) -> list[str]:
        """Return what each shape or region makes of the law of tick 0, or of another one."""
        law = self._book.compile(parameters, parameters.law) if law is None else law
        if law.evaluate is not None:
            return []
        return [
            f"{effect.name}: the law is felt with {effective(law, effect, self._period)}"
            for effect in self._effects
        ]

    def why_not(self, parameters: CouplingParameters) -> str:
        """Return why there is no verdict."""
        if parameters.plant is None:
            return f"{self._node}.plant, the device, is not declared"
        return (
            f"{self._node}.stability is off"
            if parameters.stability == "off"
            else "the law has code of its own"
        )

    def of_moving_world(
        self,
        parameters: CouplingParameters,
        delay: float,
        law: CompiledLaw | None = None,
        name: str = "",
    ) -> list[str]:
        """Return certificates of a law for every moving world, this hand and any hand.

        The law of tick 0, or one that is compiled already, with its name.

        A world that answers in the same tick may be any; a stepped tool may touch anything; a
        second device may be in any hand, as this one. Empty for a coupling to a wall, and for a law
        without poles.
        """
        plant = parameters.plant
        if plant is None or parameters.stability == "off":
            return []
        name = name or parameters.law
        law = self._book.compile(parameters, name) if law is None else law
        if (
            plant.tool_mass is None
            and plant.tool_lag is None
            and plant.partner_mass is None
        ):
            return []
        from nodes.stability.world_verdict import judge_tool, judge_world
        from nodes.stability.worlds import AnyWorld, OtherDevice, SteppedTool, WorldKind

        loop = plant.at(self._period, delay)
        world: WorldKind
        if plant.partner_mass is not None and loop.other is not None:
            world = OtherDevice(loop.other.damping, loop.other.delay)
        elif plant.tool_lag == 0.0:
            world = AnyWorld()
        else:
            late = plant.delay_before_device(loop)
            world = SteppedTool(
                plant.tool_damping, late, plant.tool_steps(self._period)
            )
        hands = (True,) if isinstance(world, OtherDevice) else (False, True)
        device = replace(loop, partner=None)
        found = [
            judge_tool(law, device, world, plant.tool_mass, any_hand)
            if isinstance(world, SteppedTool)
            else judge_world(law, device, world, any_hand)
            for any_hand in hands
        ]
        return [
            f"{self._node}.laws.{name}: {verdict.text}"
            for verdict in found
            if verdict is not None
        ]

    def unjudged(self, parameters: CouplingParameters) -> str:
        """Return why a law that will render has no verdict; empty if all have one."""
        if parameters.plant is None or parameters.stability == "off":
            return self.why_not(parameters)
        for name in _rendering(parameters):
            if self._book.compile(parameters, name).evaluate is not None:
                return (
                    f"{self._node}.laws.{name} has code of its own, which has no poles"
                )
        laws = (
            (name, self._book.compile(parameters, name))
            for name in _rendering(parameters)
        )
        return self._unjudged_field(parameters, laws)

    def at_start(
        self,
        parameters: CouplingParameters,
        delay: float,
        reason: StartAnyway = StartAnyway.NO_REASON,
    ) -> list[str]:
        """Judge the law of tick 0, the scheduled laws and the fallback. Return warnings.

        `reason` allows a start with an unstable law, as in `refuses_start`.
        """
        accepted = reason is StartAnyway.ACCEPTED_BEFORE
        if (
            parameters.stability == "refuse"
            and parameters.plant is None
            and not accepted
        ):
            raise ParameterError(
                f"refuse needs {self._node}.plant, the device that a law is"
                " judged with; declare its mass and damping, or set stability to warn",
                path=f"{self._node}.stability",
            )
        warnings = []
        for name in _rendering(parameters):
            verdict = self.verdict(
                parameters, self._book.compile(parameters, name), delay
            )
            if verdict is not None and not verdict.stable:
                complaint = self._complaint(f"laws.{name}", verdict)
                law = self._book.compile(parameters, name)
                ways = self._ways_out(None, parameters, name, law, verdict, (delay,))
                warnings.append(complaint.with_remedies(*ways))
        warnings += self._of_fallback(parameters, delay)
        policy = parameters.stability
        if warnings and refuses_start(policy, reason):
            raise warnings[0].with_remedies(
                Remedy(OTHER, f"to start anyway, set {self._node}.stability to warn")
            )
        why = (
            reason.value
            if policy in ("changes", "refuse")
            else f"{self._node}.stability is {policy}"
        )
        return [f"{warning}; started anyway: {why}" for warning in warnings]

    def _of_fallback(
        self, parameters: CouplingParameters, delay: float
    ) -> list[ParameterError]:
        if not parameters.fallback.damping:
            return []
        verdict = self.verdict(
            parameters, parameters.fallback.compile(self._period), delay
        )
        if verdict is None or verdict.stable:
            return []
        complaint = self._complaint("fallback", verdict)
        return [
            complaint.with_remedies(
                Remedy(OTHER, f"lower {self._node}.fallback.damping")
            )
        ]

    def of_change(
        self,
        now: CouplingParameters | None,
        wanted: CouplingParameters,
        name: str,
        law: CompiledLaw,
        delay: float,
        force: bool,
        likely: Sequence[float] = (),
    ) -> tuple[Verdict | None, str]:
        """Judge a law that would render after a change. Return the verdict and a warning.

        `likely`: delays at which what a refusal suggests may be judged a moment later [ticks].
        """
        verdict = self.verdict(wanted, law, delay)
        if verdict is None or verdict.stable:
            return verdict, ""
        complaint = self._complaint(f"laws.{name}", verdict)
        if force or wanted.stability == "warn":
            return verdict, str(complaint)
        raise complaint.continued("; nothing was changed").with_remedies(
            *self._ways_out(now, wanted, name, law, verdict, (delay, *likely)),
            Remedy(
                FORCE,
                f"to study it anyway, {COMMAND_LINE.force}, or set {self._node}.stability to warn",
            ),
        )

    def replace_remedies(
        self,
        error: LawRefusedError,
        now: CouplingParameters,
        wanted: CouplingParameters,
        name: str,
        force: bool,
        delays: Sequence[float],
    ) -> None:
        """Suggest the last accepted value of what was changed to a law that cannot render.

        The error of the law itself names a stiffness, at which the loop may be unstable.
        """
        if not error.remedies:
            return
        judged = [] if force or wanted.stability == "warn" else sorted(delays)[::-1]

        def accepts(parameters: CouplingParameters, law: CompiledLaw) -> bool:
            found = (self.verdict(parameters, law, delay) for delay in judged)
            return all(one is None or one.stable for one in found)

        way = self._remedies.of_law(now, wanted, name, accepts)
        error.remedies = (way,) if way.values else ()

    def refuse_fallback(
        self,
        now: CouplingParameters,
        wanted: CouplingParameters,
        delay: float,
        force: bool,
    ) -> None:
        """Reject a changed fallback that would be unstable."""
        if now.fallback != wanted.fallback and not force and wanted.stability != "warn":
            for complaint in self._of_fallback(wanted, delay):
                raise complaint.continued("; nothing was changed")

    def _complaint(self, what: str, verdict: Verdict) -> ParameterError:
        """Return the error about an unstable loop; `what`: path of the law in the parameters."""
        plant = verdict.plant
        hand = f", hand {plant.stiffness:g} N/m" if plant.stiffness else ""
        if plant.partner is not None:
            other = plant.partner
            held = f" on a spring of {other.stiffness:g} N/m" if other.stiffness else ""
            hand += f", coupled to {other.mass:g} kg, {other.damping:g} N s/m{held}"
        where = f", as it is felt at {verdict.felt}" if verdict.felt else ""
        return ParameterError(
            f"pole radius {verdict.pole_radius:.6g} (limit: < 1){where} with mass {plant.mass:g}"
            f" kg, damping {plant.damping:g} N s/m{hand} at a delay of {plant.delay:.3g} ticks: the"
            " loop is unstable",
            path=f"{self._node}.{what}",
        )

    def _ways_out(
        self,
        now: CouplingParameters | None,
        wanted: CouplingParameters,
        name: str,
        law: CompiledLaw,
        verdict: Verdict,
        delays: Sequence[float],
    ) -> list[Remedy]:
        """Return what would be accepted instead of an unstable law, at each of `delays` [ticks].

        Where nothing is accepted at all of them, what is accepted at the first one.
        """
        remedies = self._remedies

        def accepts_at(some: Sequence[float]) -> Accepts:
            # The longest first: it refuses most.
            ordered = sorted(set(some), reverse=True)
            return lambda parameters, one: all(
                self._is_stable(parameters, one, delay) for delay in ordered
            )

        always = accepts_at(delays)
        now_only = accepts_at(delays[:1])
        device = remedies.of_plant(now, wanted, law, always)
        device = device or remedies.of_plant(now, wanted, law, now_only)
        found = [] if device is None else [device]
        if verdict.felt.startswith(self._field):
            plants = [
                plant
                for delay in dict.fromkeys(delays)
                for plant in self._plants(wanted, delay)
            ]
            felt = self._felt(law)
            return [*found, remedies.in_field(felt, plants, wanted.field, self._axes)]
        if verdict.felt:
            return [*found, remedies.felt_at(verdict.felt)]
        of_law = remedies.of_law(now, wanted, name, always)
        if not of_law.values and len(set(delays)) > 1:
            of_law = remedies.of_law(now, wanted, name, now_only)
        return [*found, of_law]

    def _plants(self, parameters: CouplingParameters, delay: float) -> list[Plant]:
        """Return the declared device with each of its masses; none if it is not declared."""
        plant = parameters.plant
        return [] if plant is None else plant.over_workspace(self._period, delay)

    def _is_stable(
        self, parameters: CouplingParameters, law: CompiledLaw, delay: float
    ) -> bool:
        found = self.verdict(parameters, law, delay)
        return found is not None and found.stable


def _rendering(parameters: CouplingParameters) -> list[str]:
    """Return the names of the laws of tick 0 and of the schedule."""
    return list(
        dict.fromkeys([parameters.law, *(swap.law for swap in parameters.schedule)])
    )
