"""A recording's bodies are stepped only by positions that the environment received."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from messages.topics import DEVICE_STATE, PROXY
from messages.types import DeviceState, Proxy
from nodes.environment.bodies.moving_scene import MovingScene
from nodes.environment.bodies.node import MujocoParameters, load_world
from nodes.environment.bodies.poses import Poses, poses_file
from nodes.launcher import launch_file
from nodes.parameters.store import convert
from nodes.recording.reader import Recording
from nodes.recording.writer import RecordWriter
from nodes.view.drawn_bodies import RecordedBodies, RunningBodies
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
