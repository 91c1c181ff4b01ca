"""The bodies of a recording are stepped by the positions that the environment had, not by those that it never saw."""

from __future__ import annotations

import numpy as np
import pytest

from messages.types import DeviceState
from nodes.launcher import launch_file
from nodes.view.drawn_bodies import RecordedBodies


def test_positions_that_never_reached_the_environment_move_nothing() -> None:
    pytest.importorskip("mujoco")
    parameters = dict(launch_file.read("stack_boxes", {}).nodes["environment"].parameters)
    # A tool that goes 8 cm into the lower box's side; every fifth of its positions was lost, and lies elsewhere.
    states = [
        DeviceState(
            seq=seq,
            stamp=0.002 * seq,
            position=(0.08 * seq / 1000 if seq % 5 else -0.1, 0.0, 0.0),
            force=(0.0, 0.0, 0.0),
            force_seq=seq - 1,
        )
        for seq in range(1000)
    ]
    met = {state.seq for state in states if state.seq % 5}
    poses = []
    for given, known in (([state for state in states if state.seq in met], None), (states, met), (states, None)):
        bodies = RecordedBodies(parameters, 0.002, "environment", known)
        for state in given:
            bodies.follow(state)
        poses.append(bodies.poses())
    assert np.array_equal(poses[0], poses[1])
    assert not np.array_equal(poses[0], poses[2])
