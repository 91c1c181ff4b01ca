"""Scenes in three axes, launched: to the bit what one process plays, and its proxies those of one process on the same way."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from messages.topics import DEVICE_STATE, PROXY
from nodes.environment.shapes.kinds import Touchable
from nodes.environment.surfaces import parse_surface
from nodes.launcher import launch_file
from nodes.recording.reader import Recording
from sim.scene.spatial import play
from sim.scene.touch import touch
from tests.support.launching import launch_json

SCENES = {"sphere_feel": (), "box_edges": (), "mesh_pebble": (), "rough_plane": ("friction:=0.4",)}


@pytest.mark.parametrize("scenario", SCENES)
def test_one_process_plays_the_same(scenario: str, tmp_path: Path) -> None:
    words = [*SCENES[scenario], "pace:=lockstep", "duration:=1.6"]
    figures = launch_json(tmp_path, scenario, *words)
    recording = Recording(tmp_path / figures["recording"])
    found, states = recording.messages(PROXY), recording.messages(DEVICE_STATE)
    launch = launch_file.read(scenario, launch_file.parse_assignments(words))
    surface = parse_surface(launch.nodes["environment"].parameters["surface"], "surface")
    assert isinstance(surface, Touchable)
    path = np.array([message.position for message in found])
    # Interpreted here too: tests/nodes/environment/test_proxy.py holds that the compiled one gives the same bits.
    alone = touch(surface.solids("surface"), path, surface.tool_radius, launch.run.period, interpreted=True)
    contact = np.array([message.contact for message in found])
    assert 0.1 < contact.mean() < 0.95
    assert np.array_equal(alone.contact, contact)
    assert np.array_equal(np.where(contact[:, None], alone.proxy, path), [message.proxy for message in found])
    assert np.array_equal(alone.normal, [message.normal for message in found])
    assert np.array_equal(alone.distance, [message.distance for message in found])
    # Led aside by what it touches: more than one axis moves.
    assert (np.ptp(path[contact], axis=0) > 1e-3).sum() >= 2
    # The whole loop in one process: its states and rules are the nodes' own.
    played = play(launch)
    assert np.array_equal(played.position, [state.position for state in states[:-1]])
    assert np.array_equal(played.force, [state.force for state in states[1:]])
    assert np.array_equal(played.contact, contact[:-1])
    assert np.array_equal(played.proxy, [message.proxy for message in found[:-1]])


@pytest.mark.parametrize("words", [("puck_push",), ("knob_turn", "apply:=next_tick")], ids=lambda words: words[0])
def test_one_process_plays_what_moves(words: tuple[str, ...], tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    given = [*words[1:], "pace:=lockstep", "duration:=1.6"]
    figures = launch_json(tmp_path, words[0], *given)
    recording = Recording(tmp_path / figures["recording"])
    states, found = recording.messages(DEVICE_STATE), recording.messages(PROXY)
    played = play(launch_file.read(words[0], launch_file.parse_assignments(given)))
    assert np.array_equal(played.position, [state.position for state in states[:-1]])
    assert np.array_equal(played.force, [state.force for state in states[1:]])
    assert np.array_equal(played.proxy, [message.proxy for message in found[:-1]])
    # Something was pushed.
    assert np.abs(played.force).max() > 0.1
