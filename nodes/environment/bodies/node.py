"""The environment with moving bodies: steps a MuJoCo scene and answers with the tool."""

from __future__ import annotations

import contextlib
import functools
import math
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import msgspec

from messages import topics
from messages.codec import encode
from messages.types import ZERO, DeviceState, Proxy
from nodes.base.follow import answer_ticks
from nodes.base.node import Node
from nodes.base.setup import Axis, Setup
from nodes.environment.bodies.contacts import contacts_text
from nodes.environment.bodies.moving_scene import MovingScene
from nodes.environment.bodies.poses import RATE, Poses, poses_file
from nodes.environment.bodies.start import ControlParameters, Keyframe, controls_of
from nodes.environment.bodies.tool import ToolParameters, response_text
from nodes.environment.spent import note_spent, spent_us
from nodes.environment.spent_counters import SpentCounters
from nodes.parameters.store import ParameterError, convert


class MujocoParameters(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True
):
    """Parameters of an environment with moving bodies.

    scene: MJCF file; ``$(dirname)`` in a launch file is the folder of that file.
    tool: Body of the scene that the coupling connects to the device, or a mapping: ``{mass: 0.05,
        radius: 0.005}`` adds a ball, ``{body: NAME, damping: 0.5}`` damps a body of the scene to
        ground.
    bodies: ``dynamic``, or ``fixed`` to fix all bodies but the tool.
    lost: Distance between device and tool at which the tool is put back to the device, without a
        force [m].
    keyframe: Name or number of the keyframe of the scene at which it starts, and to which
        ``haptic node reset`` resets it; None for the state of the file.
    controls: Controls of actuators that it accepts from outside; see
        nodes/environment/bodies/start.py. None for none: all keep the controls of the start.
    """

    scene: str
    tool: str | ToolParameters = "tool"
    bodies: Literal["dynamic", "fixed"] = "dynamic"
    lost: Annotated[float, msgspec.Meta(gt=0.0)] = 0.25
    keyframe: Keyframe | None = None
    controls: ControlParameters | None = None


class MujocoEnvironment(Node):
    """Answers device states with the tool's position. It has a state, so every tick counts."""

    Parameters: ClassVar[type[msgspec.Struct]] = MujocoParameters
    publishes: ClassVar[tuple[str, ...]] = (topics.PROXY,)
    listens_to: ClassVar[tuple[str, ...]] = (topics.DEVICE_STATE,)
    answers: ClassVar[bool] = True

    @classmethod
    def check(cls, setup: Setup) -> None:
        """Load the scene before the launch."""
        load_world(
            convert(setup.parameters, MujocoParameters, setup.name),
            setup.period,
            setup.name,
        )
        if list(setup.axes) != ["x", "y", "z"]:
            raise ParameterError(
                "the tool moves in three axes, but run.axes is"
                f" [{', '.join(setup.axes)}]; name all three, or leave axes out",
                path=f"{setup.name}.tool",
            )

    @classmethod
    def axes(cls, parameters: Mapping[str, Any], name: str) -> tuple[Axis, ...]:
        """Return the axes that the scene must compute."""
        del parameters, name
        return ("x", "y", "z")

    @classmethod
    def plant(
        cls, parameters: Mapping[str, Any], name: str, axes: Sequence[Axis]
    ) -> dict[str, float]:
        """Return the tool's mass [kg], damping [N s/m] and step [s], for the coupling's checks."""
        del axes
        wanted: MujocoParameters = convert(parameters, MujocoParameters, name)
        version = 0, 0
        # `load_world` reports an unreadable file
        with contextlib.suppress(OSError):
            seen = Path(wanted.scene).expanduser().stat()
            version = seen.st_mtime_ns, seen.st_size
        mass, damping, step = _tool_facts(wanted, name, *version)
        facts = {"tool_mass": mass, "tool_damping": damping}
        return facts if step is None else facts | {"tool_step": step}

    def make_counters(self) -> SpentCounters:
        """Return the tick counters."""
        return SpentCounters()

    def configure(self) -> None:
        """Load the scene, measure its contacts, and report what the stability checks need."""
        self.begin_with(
            load_world(self.store.current, self.setup.period, self.setup.name)
        )
        self._poses = Poses(
            poses_file(self.setup.run_dir, self.setup.name),
            self._world.model.ngeom,
            make=True,
        )
        self.events.emit_each(
            "bodies",
            f"the tool weighs {self._world.mass:.4g} kg (a coupling's plant.tool_mass);"
            f" {self._world.steps} steps a tick; "
            f"{response_text(self._world.response(), self._world.euler_step)}; its"
            f" contacts, measured: {contacts_text(self._world.stiffness())}",
            {"tool_mass_kg": self._world.mass, "steps": self._world.steps},
        )

    _poses: Poses | None = None  # where pages find the bodies; None for no page

    @property
    def world(self) -> MovingScene:
        """The scene that it steps."""
        return self._world

    def begin_with(self, world: MovingScene) -> None:
        """Begin with a scene."""
        self._rebased = self._driver_rebased = 0
        self._world = world
        self._every = max(1, round(1.0 / (RATE * self.setup.period)))

    def respond(self, state: DeviceState) -> bytes | None:
        """Answer a tick's state with a proxy."""
        simulated = self.clock.simulated
        world = self._world
        seq = state.seq
        if state.safety == "fault" and not simulated:
            return None
        begin = 0.0 if simulated else time.monotonic()
        first = not 0 <= self.counters.answered < seq
        jumped = state.rebased != self._driver_rebased
        inside = world.inside
        if why := world.follow(
            seq,
            state.position,
            state.force,
            seq - 1 - state.age,
            state.delay,
            first,
            jumped,
        ):
            self._rebased = seq
            self._driver_rebased = state.rebased
            if not first:
                self.events.emit("bodies", f"{why}; the tool restarts at the device")
        if world.inside != inside:
            unfelt = "begins inside another body: nothing is felt until it is outside"
            self.events.emit(
                "inside",
                f"the tool {unfelt if world.inside else 'has come outside: all is felt now'}",
            )
        at = world.tool_position
        if not simulated:
            note_spent(self.counters.spent, time.monotonic() - begin)
        if self._poses is not None and seq % self._every == 0:
            self._poses.write(world.data.geom_xpos, world.data.geom_xmat)
        stamp = state.stamp if simulated else self.clock.now()
        # The tool is coupled from all sides: no normal, and no clamping.
        held: dict[str, Any] = {
            "proxy": at,
            "normal": ZERO,
            "distance": 0.0,
            "contact": True,
        }
        held["rebased"] = max(self._rebased, state.rebased)
        return encode(
            Proxy(
                seq=seq, stamp=stamp, position=state.position, delay=state.delay, **held
            )
        )

    def operations(self) -> dict[str, Callable[..., Any]]:
        """Return the operations: reset of the scene, and controls of its actuators."""
        return {"reset": self._reset, "controls": self._control}

    def _reset(self) -> dict[str, Any]:
        """Start the scene again at the next tick, with the tool at the device."""

        def apply(seq: int) -> dict[str, Any]:
            self._world.reset_due = True
            return {"seq": seq}

        receipt: dict[str, Any] = self.changes.hand_over(apply)
        tick = receipt["seq"]
        self.events.emit_each("reset", f"on request, from tick {tick}", {"tick": tick})
        return receipt

    def _control(self, controls: Any) -> dict[str, Any]:
        """Set controls of actuators until they are renewed or expire."""
        name = self.setup.name
        allowed = self.store.current.controls
        if allowed is None:
            raise ParameterError(
                "no controls from outside are accepted; allow them in the launch"
                " file with controls: {age: 0.1}",
                path=f"{name}.controls",
            )
        wanted = controls_of(self._world.model, controls, name)
        ticks = math.ceil(allowed.age / self.setup.period)

        def apply(seq: int) -> dict[str, Any]:
            self._world.control(wanted, seq + ticks)
            return {"seq": seq, "age_s": allowed.age}

        receipt: dict[str, Any] = self.changes.hand_over(apply)
        tick = receipt["seq"]
        for at, value in wanted.items():
            # Recorded each time, so that a replay moves the bodies as they went.
            numbers = {"actuator": at, "control": value, "until_tick": tick + ticks}
            reason = f"actuator {at}: {value:g} from tick {tick}"
            self.events.emit("controls", reason, {"tick": tick, **numbers}, always=True)
        return receipt

    def report(self) -> dict[str, Any]:
        """Return tick durations."""
        return {"spent_us": spent_us(self.counters.spent)}

    def loop(self) -> None:
        """Answer device states until stopped. A repeated state (lockstep) steps the scene once."""
        answer_ticks(self, DeviceState, topics.DEVICE_STATE, topics.PROXY, self.respond)


# period below every scene's own step [s]: nothing is stepped, only the mass is read
_SHORT = 1e-6


# a launch asks when it is read, and again when it is wired
@functools.lru_cache(maxsize=64)
def _tool_facts(
    parameters: MujocoParameters, name: str, *_version: int
) -> tuple[float, float, float | None]:
    """Return mass [kg], damping [N s/m] and step [s] of the tool of a scene.

    `_version` identifies a file that has been saved again; the step is None as of `euler_step`.
    """
    world = load_world(parameters, _SHORT, name)
    return world.mass, world.damping, world.euler_step


def load_world(parameters: MujocoParameters, period: float, name: str) -> MovingScene:
    """Return the scene of a node with these parameters."""
    held = parameters.bodies == "fixed"
    return MovingScene(
        Path(parameters.scene).expanduser(),
        parameters.tool,
        period,
        name,
        held,
        parameters.lost,
        parameters.keyframe,
    )
