"""The environment of one body: mass, spring and damper to ground, alike along all axes."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, ClassVar, Final, Literal, NamedTuple

import msgspec

from messages import topics
from messages.codec import encode
from messages.types import ZERO, DeviceState, Proxy, Vector
from nodes.base.follow import answer_ticks
from nodes.base.node import Node
from nodes.base.setup import AXIS_INDEX, Axis, Setup
from nodes.environment.spent import note_spent, spent_us
from nodes.environment.spent_counters import SpentCounters
from nodes.environment.world.dynamics import INTEGRATORS, BodyMotion, Stepped, lag_of
from nodes.parameters.checked import NonNegative
from nodes.parameters.store import ParameterError, convert

# longest time without a state that the world catches up with [s]; the rest is skipped
GAP: Final = 0.1
# least force that moves an implicit world by 1 m within one tick [N/m]
SOFTEST: Final = 1e-3
LIGHTEST: Final = 1e-6  # least mass of a stepped world [kg]


class WorldParameters(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True
):
    """Parameters of a world of one body.

    mass: Mass [kg]. stiffness: Spring to ground [N/m]. damping: Viscous damper to ground [N s/m].
    integrator: ``implicit`` (backward Euler) and ``lossless`` answer a force in the same tick and
    are passive whatever the body is; ``semi_implicit`` and ``exact`` step under the held force,
    which moves the body a tick later. steps: Sub-steps a tick of ``semi_implicit``. position: Rest
    of the spring, where the body is at first [m]; None for where the device is at the first tick.
    """

    mass: NonNegative = 0.0
    stiffness: NonNegative = 0.0
    damping: NonNegative = 0.0
    integrator: Literal["implicit", "lossless", "semi_implicit", "exact"] = "implicit"
    steps: Annotated[int, msgspec.Meta(ge=1, le=1000)] = 1
    position: Vector | None = None

    @property
    def body(self) -> tuple[float, float, float]:
        """Mass [kg], damping [N s/m] and stiffness [N/m]."""
        return self.mass, self.damping, self.stiffness


def check_world(parameters: WorldParameters, period: float, name: str) -> None:
    """Check that the integrator can move a body.

    Parameters
    ----------
    parameters : WorldParameters
        The body.
    period : float
        Sampling period [s].
    name : str
        Name of the node, for errors.

    Raises
    ------
    ParameterError
        Naming the parameter, its limit and a remedy.
    """
    mass, damping, stiffness = parameters.body
    if not math.isfinite(mass + damping + stiffness):
        raise ParameterError(
            f"mass, damping and stiffness must be finite, got {mass}, {damping}, {stiffness}",
            path=name,
        )
    if parameters.integrator in ("implicit", "lossless"):
        held = mass / period**2 + damping / period + stiffness
        if held < SOFTEST:
            raise ParameterError(
                f"a force of {held:g} N moves this body by 1 m within one tick, expected at"
                f" least {SOFTEST:g} N; raise {name}.mass, stiffness or damping",
                path=name,
            )
        return
    if mass < LIGHTEST:
        raise ParameterError(
            f"{mass:g} kg, expected at least {LIGHTEST:g} kg for integrator"
            f" {parameters.integrator}; a body without mass needs integrator implicit or lossless",
            path=f"{name}.mass",
        )
    h = period / parameters.steps
    # Semi-implicit Euler with an implicit damper: (m + h c)(z − 1)² + … is unstable iff h² k > 4 m
    # + 2 h c.
    if (
        parameters.integrator == "semi_implicit"
        and h * h * stiffness >= 4.0 * mass + 2.0 * h * damping
    ):
        least = math.ceil(period * _steps_factor(mass, damping, stiffness))
        raise ParameterError(
            f"{parameters.steps} sub-steps a tick are unstable for {mass:g} kg on"
            f" {stiffness:g} N/m, with or without a coupling; expected at least {least}",
            path=f"{name}.steps",
        )


def _steps_factor(mass: float, damping: float, stiffness: float) -> float:
    """Return the least sub-steps per second for which h² k < 4 m + 2 h c."""
    return (
        stiffness
        / (damping + math.sqrt(damping * damping + 4.0 * mass * stiffness))
        * (1.0 + 1e-9)
    )


class BodyPlace(NamedTuple):
    """Position of the world at a tick."""

    # position without this tick's force; the device's along axes that are not computed [m]
    proxy: Vector
    compliance: float  # motion due to this tick's force [m/N]


class FeltWorld:
    """A body along some axes that follows the ticks of a loop."""

    def __init__(
        self, parameters: WorldParameters, period: float, axes: Sequence[str]
    ) -> None:
        self._period = period
        self._axes = [AXIS_INDEX[axis] for axis in axes]
        self._rest: Vector = ZERO
        self._tick = -1
        self._most = max(1, round(GAP / period))
        self.set(parameters)

    def set(self, parameters: WorldParameters) -> None:
        """Change the parameters; position and velocity of the body are kept."""
        states = (
            [motion.state() for motion in self._motions]
            if self._tick >= 0
            else [(0.0, 0.0)] * len(self._axes)
        )
        kind = INTEGRATORS[parameters.integrator]
        self._parameters = parameters
        self._motions: list[BodyMotion] = [
            kind(parameters.body, self._period, parameters.steps, at) for at in states
        ]
        self.compliance = self._motions[0].compliance

    def follow(
        self, tick: int, position: Vector, force: Vector, since: int, delay: float
    ) -> BodyPlace:
        """Advance the body to a tick.

        Parameters
        ----------
        tick : int
            The tick.
        position : tuple of float, shape (3,)
            Position of the device [m].
        force : tuple of float, shape (3,)
            Last force handed to the device, after all limits [N].
        since : int
            Tick that this force answers.
        delay : float
            Time from that tick's sample to when the force took effect [ticks].

        Returns
        -------
        BodyPlace
            Position and compliance of the body.
        """
        if self._tick < 0:
            self._rest = (
                position
                if self._parameters.position is None
                else self._parameters.position
            )
            self._tick = tick
        begin = max(self._tick, tick - self._most)
        for i, motion in zip(self._axes, self._motions, strict=True):
            if isinstance(motion, Stepped) and tick > self._tick:
                motion.hand_over(force[i], max(since + delay - begin, 0.0))
            # If a tick's answer was late or lost, the force on the device at that time applies.
            for _ in range(begin, tick):
                motion.close(force[i])
        self._tick = tick
        at = list(position)
        for i, motion in zip(self._axes, self._motions, strict=True):
            at[i] = self._rest[i] + motion.free()
        return BodyPlace((at[0], at[1], at[2]), self.compliance)


class WorldEnvironment(Node):
    """Answers device states with a body's position. It has a state, so every tick counts."""

    Parameters: ClassVar[type[msgspec.Struct]] = WorldParameters
    publishes: ClassVar[tuple[str, ...]] = (topics.PROXY,)
    listens_to: ClassVar[tuple[str, ...]] = (topics.DEVICE_STATE,)
    answers: ClassVar[bool] = True

    @classmethod
    def check(cls, setup: Setup) -> None:
        """Check the body before the launch."""
        check_world(
            convert(setup.parameters, WorldParameters, setup.name),
            setup.period,
            setup.name,
        )

    @classmethod
    def plant(
        cls, parameters: Mapping[str, Any], name: str, axes: Sequence[Axis]
    ) -> dict[str, float]:
        """Return a stepped body as the coupling's tool; otherwise only that it has no lag."""
        del axes
        wanted: WorldParameters = convert(parameters, WorldParameters, name)
        if not issubclass(INTEGRATORS[wanted.integrator], Stepped):
            return {"tool_lag": 0.0}
        mass, damping, stiffness = wanted.body
        lag = lag_of(wanted.integrator, wanted.steps)
        return {
            "tool_mass": mass,
            "tool_damping": damping,
            "tool_stiffness": stiffness,
            "tool_lag": lag,
        }

    def make_counters(self) -> SpentCounters:
        """Return the tick counters."""
        return SpentCounters()

    def configure(self) -> None:
        """Create the body and report it."""
        parameters: WorldParameters = self.store.current
        check_world(parameters, self.setup.period, self.setup.name)
        self._world = FeltWorld(parameters, self.setup.period, self.setup.axes)
        self.events.emit_each("world", described(parameters))

    def prepare(self, parameters: Any) -> Callable[[int], Any]:
        """Prepare another body at the same position."""
        check_world(parameters, self.setup.period, self.setup.name)

        def apply(seq: int) -> dict[str, Any]:
            self._world.set(parameters)
            return {"seq": seq, "world": described(parameters)}

        return apply

    def respond(self, state: DeviceState) -> bytes | None:
        """Answer a tick's state with a proxy."""
        simulated = self.clock.simulated
        if state.safety == "fault" and not simulated:
            return None
        begin = 0.0 if simulated else time.monotonic()
        at = self._world.follow(
            state.seq,
            state.position,
            state.force,
            state.seq - 1 - state.age,
            state.delay,
        )
        if not simulated:
            note_spent(self.counters.spent, time.monotonic() - begin)
        stamp = state.stamp if simulated else self.clock.now()
        # The body is coupled from both sides: no normal, and no clamping.
        met: dict[str, Any] = {
            "proxy": at.proxy,
            "normal": ZERO,
            "distance": 0.0,
            "contact": True,
            "compliance": at.compliance,
        }
        met["rebased"] = state.rebased
        return encode(
            Proxy(
                seq=state.seq,
                stamp=stamp,
                position=state.position,
                delay=state.delay,
                **met,
            )
        )

    def report(self) -> dict[str, Any]:
        """Return tick durations."""
        return {"spent_us": spent_us(self.counters.spent)}

    def loop(self) -> None:
        """Answer device states until stopped. A repeated state (lockstep) moves the body once."""
        answer_ticks(self, DeviceState, topics.DEVICE_STATE, topics.PROXY, self.respond)


def described(parameters: WorldParameters) -> str:
    """Return a world as text: body, integrator, sub-steps and lag."""
    mass, damping, stiffness = parameters.body
    integrator, steps = parameters.integrator, parameters.steps
    body = f"{mass:g} kg, {stiffness:g} N/m, {damping:g} N s/m"
    if not issubclass(INTEGRATORS[integrator], Stepped):
        return (
            f"{body}, {integrator}: answers a force in the same tick, and is passive whatever its"
            " numbers are"
        )
    lag = lag_of(integrator, steps)
    late = "1 tick" if lag == 1.0 else f"{lag:.3g} ticks"
    sub_steps = f", {steps} sub-steps a tick" if integrator == "semi_implicit" else ""
    return (
        f"{body}, {integrator}{sub_steps}: stepped, answers a force late by {late}, and is "
        "passive to the loop by its own damping only"
    )
