"""A recording's bodies are stepped only by positions that the environment received."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from mcap.reader import make_reader

from messages.topics import DEVICE_STATE, PROXY, event
from messages.types import DeviceState, Event, Proxy
from nodes.environment.bodies.moving_scene import MovingScene
from nodes.environment.bodies.node import MujocoParameters, load_world
from nodes.environment.bodies.poses import Poses, poses_file
from nodes.environment.shown_offsets import offsets_file
from nodes.environment.surfaces import parse_surface
from nodes.environment.touched_surface import TouchedSurface
from nodes.launcher import launch_file
from nodes.parameters.store import convert
from nodes.recording.reader import Recording
from nodes.recording.writer import RecordWriter
from nodes.view.drawn_bodies import (
    RecordedBodies,
    RecordedShapes,
    RunningBodies,
    RunningShapes,
    scene_changes,
)
from nodes.view.foxglove_scene import SCENE, export_foxglove
from nodes.view.shape import bodies_of
from tests.support.setups import MadeLater, setup_of

STATES = [
    DeviceState(
        seq=seq,
        stamp=0.002 * seq,
        position=(0.08 * seq / 1000 if seq % 5 else -0.1, 0.0, 0.0),
        force=(0.0, 0.0, 0.0),
        force_seq=seq - 1,
    )
    for seq in range(1000)
]
"""A tool that moves 8 cm into the lower box's side; every fifth position is lost."""


@pytest.fixture
def parameters() -> dict[str, Any]:
    pytest.importorskip("mujoco")
    return dict(launch_file.read("stack_boxes", {}).nodes["environment"].parameters)


def test_positions_that_never_reached_the_environment_move_nothing(
    parameters: dict[str, Any],
) -> None:
    met = {state.seq for state in STATES if state.seq % 5}
    poses = []
    for given, known in (
        ([state for state in STATES if state.seq in met], None),
        (STATES, met),
        (STATES, None),
    ):
        bodies = RecordedBodies(parameters, 0.002, "environment", known)
        for state in given:
            bodies.follow(state)
        poses.append(bodies.poses())
    assert np.array_equal(poses[0], poses[1])
    assert not np.array_equal(poses[0], poses[2])


ARM = """<mujoco><worldbody><body name="arm" pos="0 0.2 0">
<joint name="hinge" axis="0 1 0" damping="0.01"/>
<geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.01"/></body></worldbody>
<actuator><position name="elbow" joint="hinge" kp="1"/></actuator>
<keyframe><key name="up" qpos="-0.5" ctrl="-0.5"/></keyframe></mujoco>"""


def test_recorded_controls_and_resets_move_the_bodies_again(tmp_path: Path) -> None:
    """Two controls, their end after 100 ticks, a reset, and a jump of the device."""
    pytest.importorskip("mujoco")
    (tmp_path / "arm.xml").write_text(ARM, encoding="ascii")
    parameters = {
        "scene": str(tmp_path / "arm.xml"),
        "tool": {"mass": 0.05},
        "keyframe": "up",
        "controls": {"age": 0.2},
    }
    live, went = load_world_of(parameters), []
    numbers: dict[int, tuple[str, dict[str, float]]] = {
        50: ("controls", {"actuator": 0.0, "control": 0.4, "until_tick": 150.0}),
        120: ("controls", {"actuator": 0.0, "control": -0.2, "until_tick": 220.0}),
        300: ("reset", {}),
    }
    states = [
        msgspec.structs.replace(one, rebased=350 if one.seq >= 350 else 0)
        for one in STATES[:400]
    ]
    path = tmp_path / "run.mcap"
    with RecordWriter(path, {"rate_hz": "500"}) as writer:
        for state in states:
            kind, data = numbers.get(state.seq, ("", {}))
            if kind == "reset":
                live.reset_due = True
            elif kind:
                live.control({0: data["control"]}, round(data["until_tick"]))
            if kind:
                told = Event(
                    seq=state.seq,
                    stamp=state.stamp,
                    node="environment",
                    kind=kind,
                    reason="r",
                    data={"tick": float(state.seq), **data},
                )
                writer.write(event("environment"), told, state.stamp)
            live.follow(
                state.seq,
                state.position,
                state.force,
                state.seq - 1 - state.age,
                state.delay,
                state.seq == 0,
                state.seq == 350,
            )
            went.append(live.data.qpos.copy())
    changes = scene_changes(Recording(path), "environment")
    drawn = RecordedBodies(parameters, 0.002, "environment", changes=changes)
    for state, pose in zip(states, went, strict=True):
        drawn.follow(state)
        assert np.array_equal(drawn.world.data.qpos, pose)
    plain = RecordedBodies(parameters, 0.002, "environment")
    for state in states[:150]:
        plain.follow(state)
    assert np.abs(plain.world.data.qpos - went[149]).max() > 0.05


def test_bodies_of_an_environment_that_starts_later_are_waited_for(
    parameters: dict[str, Any], tmp_path: Path
) -> None:
    """A view faster than the environment had no bodies for a whole run."""
    setup = setup_of(
        name="environment",
        run_dir=str(tmp_path),
        control="ipc:///c",
        parameters=parameters,
    )
    path, count = (
        poses_file(tmp_path, "environment"),
        len(bodies_of(load_world_of(parameters))["parts"]),
    )
    given_up = MadeLater(
        path,
        lambda: Poses(path, count, make=True).write(
            np.ones((count, 3)), np.ones((count, 9))
        ),
    )

    found = RunningBodies(setup, given_up).news()
    assert given_up.asked == 3
    assert found == {"poses": np.ones((count, 12)).tolist()}


def test_bodies_on_another_machine_are_not_waited_for(
    parameters: dict[str, Any], tmp_path: Path
) -> None:
    setup = setup_of(
        name="environment",
        run_dir=str(tmp_path),
        control="tcp://10.0.0.1:5",
        parameters=parameters,
    )
    with pytest.raises(FileNotFoundError):
        RunningBodies(setup, lambda: False)


def load_world_of(parameters: dict[str, Any]) -> MovingScene:
    return load_world(
        convert(parameters, MujocoParameters, "environment"), 0.002, "environment"
    )


def test_foxglove_is_shown_the_bodies_where_the_replay_shows_them(
    parameters: dict[str, Any], tmp_path: Path
) -> None:
    recording, out = tmp_path / "run.mcap", tmp_path / "foxglove.mcap"
    # None of the first ticks reached the environment: it begins late, as the bodies do.
    met = [state for state in STATES if state.seq % 5 and state.seq > 100]
    known = {"environment": json.dumps(parameters)}
    with RecordWriter(recording, {"rate_hz": "500"}, parameters=known) as writer:
        for state in STATES:
            writer.write(DEVICE_STATE, state, state.stamp)
            if state in met:
                proxy = Proxy(
                    seq=state.seq,
                    stamp=state.stamp,
                    position=state.position,
                    proxy=state.position,
                )
                writer.write(PROXY, proxy, state.stamp)
    export_foxglove(Recording(recording), out)
    with out.open("rb") as stream:
        updates = [
            json.loads(message.data)
            for _, _, message in make_reader(stream).iter_messages(topics=[SCENE])
        ]
    drawn = [
        entity
        for update in updates
        for entity in update["entities"]
        if entity["id"] == "bodies"
    ][-1]
    bodies = RecordedBodies(parameters, 0.002, "environment")
    until = round(
        (drawn["timestamp"]["sec"] + drawn["timestamp"]["nsec"] * 1e-9) * 500.0
    )
    for state in met:
        if state.seq <= until:
            bodies.follow(state)
    places = bodies.poses()[:, :3].tolist()
    shown = [
        list(one["pose"]["position"].values())
        for kind in ("cubes", "spheres")
        for one in drawn[kind]
    ]
    assert len(shown) == len(places)
    assert sorted(shown) == sorted(places)


BALL: dict[str, Any] = {"kind": "sphere", "position": [0.05, 0.0, 0.0], "radius": 0.02}
MOVING: dict[str, Any] = {
    "kind": "union",
    "shapes": [
        BALL,
        {
            **BALL,
            "position": [0.0, 0.0, -0.03],
            "motion": {
                "path": [[0.0, 0.0, 0.0, 0.0], [1.0, 0.05, 0.0, 0.01]],
                "power": 0.001,
            },
        },
    ],
}


def test_shapes_that_move_are_shown_where_the_environment_has_them(
    tmp_path: Path,
) -> None:
    """Also where a device slows them, after a change of the surface, and in a replay."""
    setup = setup_of(name="environment", run_dir=str(tmp_path), parameters={})
    path, running = offsets_file(tmp_path, "environment"), RunningShapes(setup)
    assert running.news() is None, "no environment yet"
    place = TouchedSurface(parse_surface(MOVING, "surface"), 0.002)
    place.show(path)
    recorded = RecordedShapes({"surface": MOVING}, 0.002)
    assert recorded.moves
    slowed = 0
    for seq in range(400):
        # From 0.2 s on the device lies in its way, and pushes it back with 3 N.
        at = (0.025, 0.0, -0.028) if seq >= 100 else (0.0, 0.05, 0.0)
        force = (3.0, 0.0, 0.0) if seq >= 100 else (0.0, 0.0, 0.0)
        place.note(seq, force)
        place.meet(at)
        state = DeviceState(
            seq=seq, stamp=0.002 * seq, position=at, force=force, force_seq=seq - 1
        )
        recorded.follow(state)
        news = running.news()
        assert news is not None
        (pose,) = news["poses"]
        wanted = [0.05 * seq * 0.002, 0.0, 0.01 * seq * 0.002]
        assert pose[3:] == np.eye(3).ravel().tolist()
        assert recorded.poses()[0, :3] == pytest.approx(pose[:3], abs=1e-6)
        slowed += math.dist(pose[:3], wanted) > 1e-5
        # Written with six decimals, and never ahead of its path.
        assert pose[0] <= wanted[0] + 1e-6
        assert slowed or pose[:3] == pytest.approx(wanted, abs=1e-6)
    assert slowed > 50
    stiff = {**MOVING, "tool_radius": 0.002}
    after = TouchedSurface(parse_surface(stiff, "surface"), 0.002)
    after.show(path)
    place.take(after)
    shown = running.news()
    assert shown is not None
    assert shown["poses"][0][:3] == pytest.approx(pose[:3], abs=1e-6)


def test_a_surface_that_stays_has_no_file(tmp_path: Path) -> None:
    place = TouchedSurface(parse_surface(BALL, "surface"), 0.002)
    place.show(tmp_path / "environment.shapes")
    assert list(tmp_path.iterdir()) == []
    assert not RecordedShapes({"surface": BALL}, 0.002).moves
