"""Poses of moving bodies and shapes for a page: of a running environment, or recomputed."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Container, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from messages.topics import PROXY, event
from messages.types import DeviceState, Vector
from nodes.base.setup import Setup
from nodes.base.shared_file import awaited
from nodes.environment.bodies.moving_scene import MovingScene
from nodes.environment.bodies.node import MujocoParameters, load_world
from nodes.environment.bodies.poses import Poses, file_size, poses_file
from nodes.environment.shown_offsets import ShownOffsets, offsets_file, offsets_of
from nodes.environment.surfaces import parse_surface
from nodes.environment.touched_surface import TouchedSurface
from nodes.parameters.store import convert
from nodes.recording.reader import Recording
from nodes.view.shape import bodies_of


class RunningBodies:
    """Bodies of a running environment; OSError if it is on another machine.

    The environment may start later than this.
    """

    def __init__(self, setup: Setup, given_up: Callable[[], bool]) -> None:
        parameters: MujocoParameters = convert(
            setup.parameters, MujocoParameters, setup.name
        )
        world = load_world(parameters, setup.period, setup.name)
        count = world.model.ngeom
        self._poses = Poses(
            awaited(
                poses_file(setup.run_dir, setup.name), file_size(count), setup, given_up
            ),
            count,
        )
        self.shape = bodies_of(world)  # their triangles

    def news(self) -> dict[str, Any] | None:
        """Return the present poses; None if not known yet."""
        found = self._poses.read()
        return None if found is None else {"poses": np.round(found, 6).tolist()}


def met_ticks(recording: Recording, topic: str = PROXY) -> Container[int] | None:
    """Return the ticks that the environment answered; None if no answers were recorded."""
    return (
        {message.seq for message in recording.messages(topic)}
        if topic in recording.topics
        else None
    )


def _unturned(offsets: Sequence[Vector]) -> NDArray[np.float64]:
    """Return poses of shapes that are moved and not turned, shape (n, 12)."""
    upright = np.hstack([np.zeros(3), np.eye(3).ravel()])
    poses = np.tile(upright, (len(offsets), 1))
    poses[:, :3] = np.reshape(offsets, (-1, 3))
    return poses


class RunningShapes:
    """Moving shapes of a running environment, on this machine."""

    def __init__(self, setup: Setup) -> None:
        self._offsets = ShownOffsets(offsets_file(setup.run_dir, setup.name))

    def news(self) -> dict[str, Any] | None:
        """Return the present poses; None if not known."""
        found = self._offsets.read()
        return (
            None if found is None else {"poses": np.round(_unturned(found), 6).tolist()}
        )


class RecordedShapes:
    """Moving shapes of a recording, found by meeting its positions as the node did.

    Only the ticks in `met` (see `met_ticks`) reached the node. A shape without a path moved to
    where a topic put it, which is not recorded: it stays.
    """

    def __init__(
        self,
        parameters: dict[str, Any],
        period: float,
        met: Container[int] | None = None,
    ) -> None:
        self._met = met
        surface = parse_surface(parameters["surface"], "surface")
        self._place = TouchedSurface(surface, period)
        self._rebased = 0

    @property
    def moves(self) -> bool:
        """Whether any of its shapes moves."""
        return self._place.moved is not None

    def follow(self, state: DeviceState) -> None:
        """Move the shapes to a state's tick."""
        if state.safety == "fault" or (
            self._met is not None and state.seq not in self._met
        ):
            return
        if state.rebased != self._rebased:
            self._rebased = state.rebased
            self._place.begin()
        self._place.note(state.seq, state.force)
        self._place.meet(state.position)

    def poses(self) -> NDArray[np.float64]:
        """Return the present poses, shape (n, 12)."""
        numbers = self._place.numbers
        return _unturned([] if numbers is None else offsets_of(numbers.table))


class SceneChange(NamedTuple):
    """A reset of a scene, or a control of one of its actuators, from a tick on."""

    tick: int
    actuator: int = -1  # −1 for a reset
    control: float = 0.0
    until: int = 0  # tick at which the controls of the start return


def scene_changes(recording: Recording, name: str) -> list[SceneChange]:
    """Return the recorded resets and controls of the scene of node `name`, by tick."""
    topic = event(name)
    found = []
    for one in recording.messages(topic) if topic in recording.topics else ():
        numbers = one.data
        if one.kind == "reset" and "tick" in numbers:
            found.append(SceneChange(int(numbers["tick"])))
        elif one.kind == "controls" and {"tick", "actuator", "control"} <= set(numbers):
            found.append(
                SceneChange(
                    int(numbers["tick"]),
                    int(numbers["actuator"]),
                    numbers["control"],
                    int(numbers.get("until_tick", numbers["tick"])),
                )
            )
    return sorted(found, key=lambda one: one.tick)


class RecordedBodies:
    """Bodies of a recording, found by stepping its scene as the node did.

    Only the ticks in `met` (see `met_ticks`) step the scene; `changes` (see `scene_changes`)
    are applied at theirs.
    """

    def __init__(
        self,
        parameters: dict[str, Any],
        period: float,
        name: str,
        met: Container[int] | None = None,
        changes: Sequence[SceneChange] = (),
    ) -> None:
        self._met = met
        # the scene
        self.world: MovingScene = load_world(
            convert(parameters, MujocoParameters, name), period, name
        )
        self._changes = deque(
            one for one in changes if one.actuator < self.world.model.nu
        )
        # Whether a tick was passed to `follow`, and whether one was stepped.
        self.asked = self._begun = False
        self._rebased = 0  # jump of the device that the scene has followed

    def follow(self, state: DeviceState) -> None:
        """Step the scene to a state's tick."""
        self.asked = True
        if state.safety == "fault" or (
            self._met is not None and state.seq not in self._met
        ):
            return
        while self._changes and self._changes[0].tick <= state.seq:
            one = self._changes.popleft()
            if one.actuator < 0:
                self.world.reset_due = True
            else:
                self.world.control({one.actuator: one.control}, one.until)
        if self.world.follow(
            state.seq,
            state.position,
            state.force,
            state.seq - 1 - state.age,
            state.delay,
            not self._begun,
            state.rebased != self._rebased,
        ):
            self._rebased = state.rebased
        self._begun = True

    def poses(self) -> NDArray[np.float64]:
        """Return the present poses: position and rotation matrix per geom."""
        return np.hstack([self.world.data.geom_xpos, self.world.data.geom_xmat])
