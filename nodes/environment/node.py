"""The environment node: answers each device position with the proxy on a surface.

Its only state is the surface, so a lost or repeated position costs nothing. It forwards position
and measured delay, so that the coupling needs one input only.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import msgspec

from messages import topics
from messages.types import DeviceState, Vector
from nodes.base.follow import answer_ticks
from nodes.base.node import Node
from nodes.base.setup import AXIS_INDEX, Axis, Effect, Setup
from nodes.compiled.layout import state_of
from nodes.compiled.published import payload_of
from nodes.environment.shown_offsets import address_of, offsets_file
from nodes.environment.spent import note_spent, spent_us
from nodes.environment.state import (
    DAMPING,
    DISTANCE,
    PUBLISHED,
    SHAPES,
    STIFFNESS,
    UNKNOWN,
    EnvironmentState,
    tell_jump,
)
from nodes.environment.surfaces import (
    SURFACES,
    Meeting,
    Surface,
    meet_axes,
    parse_surface,
    surface_effects,
)
from nodes.environment.touched_surface import TouchedSurface
from nodes.parameters.store import ParameterError, convert, differences

if TYPE_CHECKING:
    from nodes.compiled.answering import CompiledTicks
    from nodes.compiled.library import Kernel


_payload = payload_of(PUBLISHED)


class EnvironmentParameters(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True
):
    """Parameters of the environment.

    surface: ``kind`` and parameters of the surface (nodes/environment/surfaces.py).
    ease: Time over which the force changes after the surface was replaced [s]; None for the
        coupling's own ``ease``.
    """

    surface: dict[str, Any] = msgspec.field(default_factory=lambda: {"kind": "free"})
    ease: Annotated[float, msgspec.Meta(gt=0.0, le=10.0)] | None = None


class Environment(Node):
    """Answers device states with the proxy on a surface."""

    Parameters: ClassVar[type[msgspec.Struct]] = EnvironmentParameters
    publishes: ClassVar[tuple[str, ...]] = (topics.PROXY,)
    listens_to: ClassVar[tuple[str, ...]] = (topics.DEVICE_STATE,)
    answers: ClassVar[bool] = True
    kernel_module: ClassVar[str] = "nodes.environment.kernel"

    counters: EnvironmentState

    @classmethod
    def kernel_of(cls, parameters: Mapping[str, Any]) -> str:
        """Return the module of compiled ticks. Shapes have their own: they compile slowly."""
        surface = parameters.get("surface", {})
        kind = surface.get("kind", "free") if isinstance(surface, Mapping) else "free"
        known: Surface | None = (
            SURFACES.load(kind) if kind in SURFACES.names() else None
        )
        return cls.kernel_module if known is None else known.kernel_module

    @classmethod
    def check(cls, setup: Setup) -> None:
        """Check the surface before the launch."""
        where = f"{setup.name}.surface"
        surface = parse_surface(
            setup.parameters.get("surface", {"kind": "free"}), where
        )
        meet_axes(surface, setup.axes, where)
        surface.check(where)

    @classmethod
    def axes(cls, parameters: Mapping[str, Any], name: str) -> tuple[Axis, ...]:
        """Return the axes that the scene must compute."""
        return (
            parse_surface(
                parameters.get("surface", {"kind": "free"}), f"{name}.surface"
            ).pushes()
            or ()
        )

    @classmethod
    def effects(cls, parameters: Mapping[str, Any], name: str) -> list[Effect]:
        """Return what shapes and regions do to a law."""
        return surface_effects(
            parameters.get("surface", {"kind": "free"}), f"{name}.surface"
        )

    def configure(self) -> None:
        """Build the surface."""
        self.begin_with(*self._built(self.store.current))

    def begin_with(
        self, place: TouchedSurface, meet: Callable[[Vector], Meeting] | None = None
    ) -> None:
        """Begin with a surface, and a function that meets it in place of its own."""
        self._place = place
        self._touch(place.meet if meet is None else meet)

    def make_counters(self) -> EnvironmentState:
        """Return the state."""
        return state_of(
            EnvironmentState,
            self.setup.tick == "compiled",
            seq=-1,
            answered=-1,
            kind=UNKNOWN,
        )

    def _touch(self, meet: Callable[[Vector], Meeting]) -> None:
        """Use the surface of `_place`; interpreted and compiled ticks share its proxy's memory."""
        self._meet = meet
        s = self.counters
        numbers = self._place.numbers
        s.kind = self._place.kind
        if numbers is not None:
            if numbers.widths:
                self.events.emit_each("mesh", "; ".join(numbers.widths))
            if numbers.repairs:
                self.events.emit_each("mesh", f"repaired: {'; '.join(numbers.repairs)}")
            s.table, s.table_count = address_of(numbers.table)
            s.memory, s.memory_count = numbers.memory.buffer_info()

    def _built(
        self, parameters: EnvironmentParameters
    ) -> tuple[TouchedSurface, Callable[[Vector], Meeting]]:
        where = f"{self.setup.name}.surface"
        surface = parse_surface(parameters.surface, where)
        meet_axes(surface, self.setup.axes, where)
        place = TouchedSurface(surface, self.setup.period, self.counters.met)
        if self.setup.run_dir:
            place.show(offsets_file(self.setup.run_dir, self.setup.name))
        return place, place.meet if surface.pushes() is not None else self._watched(
            place.meet
        )

    def _watched(
        self, meet: Callable[[Vector], Meeting]
    ) -> Callable[[Vector], Meeting]:
        """Report when a surface pushes along an axis that the scene does not compute."""
        left_out = [
            (i, axis) for axis, i in AXIS_INDEX.items() if axis not in self.setup.axes
        ]

        def watched(position: Vector) -> Meeting:
            met = meet(position)
            for axis in [
                axis for i, axis in left_out if met[3] and met[0][i] != position[i]
            ]:
                computed = ", ".join(self.setup.axes)
                self.events.emit(
                    "axes",
                    f"the surface pushes along {axis}, but run.axes is [{computed}]: no force"
                    " there",
                    {"axis": AXIS_INDEX[axis]},
                )
            return met

        return watched

    def prepare(self, parameters: Any) -> Callable[[int], Any]:
        """Prepare a new surface; its proxy starts where the old one is.

        The coupling is told of the jump and eases it. If only the friction differs, nothing jumps.
        """
        if parameters.surface == self.store.current.surface:
            return lambda seq: {"seq": seq, "surface": parameters.surface}
        self._refuse_unjudged(parameters)
        with self.loading:
            place, meet = self._built(parameters)
        changed = differences(self.store.current, parameters)
        news = ", ".join(
            f"{path} {'none' if old is None else old} → {'none' if new is None else new}"
            for path, (old, new) in changed.items()
            if path.startswith("surface")
        )

        def apply(seq: int) -> dict[str, Any]:
            jump = self._place.take(place)
            s = self.counters
            self._touch(meet)
            # Each one: a page draws it anew.
            self.events.emit("surface", news, always=True)
            if jump:
                s.rebased = seq
                s.ease = (
                    0
                    if parameters.ease is None
                    else max(round(parameters.ease / self.setup.period), 1)
                )
            return {"seq": seq, "surface": parameters.surface, "rebased": s.rebased}

        return apply

    def _refuse_unjudged(self, parameters: EnvironmentParameters) -> None:
        """Reject factors and regions that the coupling's laws were not judged with at the start."""
        where = f"{self.setup.name}.surface"

        def kinds(surface: dict[str, Any]) -> set[tuple[float, float, float]]:
            found = surface_effects(surface, where)
            return {(one.stiffness, one.damping, one.lag) for one in found} | {
                (1.0, 1.0, 0.0)
            }

        launched = self.setup.parameters.get("surface", {"kind": "free"})
        new = kinds(parameters.surface) - kinds(launched)
        if new:
            stiffness, damping, lag = min(new)
            raise ParameterError(
                f"stiffness {stiffness:g}, damping {damping:g}, time {lag:g} s are not"
                " among the factors and regions of the launch file, with which laws were judged;"
                " launch again with them",
                path=where,
            )

    def compiled_ticks(self, kernel: Kernel) -> CompiledTicks[EnvironmentState]:
        """Return the compiled ticks."""
        from nodes.environment.compiled_tick import EnvironmentTicks

        shapes = self.kernel_of(self.setup.parameters) != self.kernel_module
        return EnvironmentTicks(self, kernel, shapes, self._note_inside)

    def respond(self, state: DeviceState) -> bytes | None:
        """Answer a tick's state with a proxy."""
        simulated = self.clock.simulated
        if state.safety == "fault" and not simulated:
            # The position is outdated; the coupling bridges the gap. In lockstep the driver waits
            # for an answer.
            return None
        begin = 0.0 if simulated else time.monotonic()
        s = self.counters
        if not 0 <= s.answered < state.seq or state.rebased != s.driver_rebased:
            self._meet_anew(state)
        self._place.note(state.seq, state.force)
        proxy, normal, distance, contact = self._meet(state.position)
        if s.kind == SHAPES or s.inside != 0:
            if self._place.jumped:
                s.rebased = state.seq
                s.ease = 0
            self._note_inside()
        if not simulated:
            note_spent(s.spent, time.monotonic() - begin)
        s.stamp = state.stamp if simulated else self.clock.now()
        s.seq = state.seq
        s.position[:], s.delay, s.contact = state.position, state.delay, contact
        if s.kind == UNKNOWN:
            s.met[: DISTANCE + 1] = (*proxy, *normal, distance)
            s.met[STIFFNESS], s.met[DAMPING] = 1.0, 1.0
        tell_jump(s)
        return _payload(s, "")

    def _meet_anew(self, state: DeviceState) -> None:
        """Restart the proxy at the device: first tick of a driver, or a jump of its position."""
        s = self.counters
        if s.answered >= 0:
            self._place.begin()
        if not 0 <= s.answered < state.seq or state.rebased <= s.rebased:
            # Also if the driver counts from zero again: an earlier jump of this node must not hide
            # this one.
            s.rebased = state.seq
            s.ease = 0
        s.driver_rebased = state.rebased

    def _note_inside(self) -> None:
        """Report a change in the number of solids not felt because the tool began inside."""
        inside = self._place.inside
        if inside > self.counters.inside:
            solids = "a solid that is" if inside == 1 else f"{inside} solids that are"
            self.events.emit_each(
                "inside",
                f"the tool begins inside of {solids} not felt until it is outside",
                {"solids": inside},
            )
        elif inside < self.counters.inside:
            left = (
                "all solids are felt now"
                if inside == 0
                else f"{inside} solids are still not felt"
            )
            self.events.emit_each(
                "inside", f"the tool has come outside: {left}", {"solids": inside}
            )
        self.counters.inside = inside

    def operations(self) -> dict[str, Callable[..., Any]]:
        """Return the operation that moves a shape."""
        return {"move": self._move}

    def _move(self, position: Any, shape: Any = 0) -> dict[str, Any]:
        """Set the offset to which shape number `shape` moves at its speed [m]."""
        where = f"{self.setup.name}.surface"
        offset: Vector = convert(position, Vector, f"{where}.position")
        movers = parse_surface(self.store.current.surface, where).movers()
        is_number = isinstance(shape, (int, float)) and not isinstance(shape, bool)
        if not is_number or shape not in movers:
            known = ", ".join(map(str, movers)) or "none"
            raise ParameterError(
                f"shape {shape!r} does not move to a topic; shapes that do: {known}"
                " (motion: {speed: 0.1} without a path)",
                path=where,
            )
        solid = movers[shape]

        def apply(seq: int) -> dict[str, Any]:
            self._place.aim(solid, offset)
            return {"seq": seq}

        receipt: dict[str, Any] = self.changes.hand_over(apply)
        return receipt

    def report(self) -> dict[str, Any]:
        """Return tick durations, and the energy that moving shapes have put into the device."""
        moved = self._place.moved
        told = (
            {}
            if moved is None
            else {"moved": {"energy_j": moved[0], "power_w": moved[1]}}
        )
        return {"spent_us": spent_us(self.counters.spent), **told}

    def loop(self) -> None:
        """Answer device states until stopped."""
        answer_ticks(self, DeviceState, topics.DEVICE_STATE, topics.PROXY, self.respond)
