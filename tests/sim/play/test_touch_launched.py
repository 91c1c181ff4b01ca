"""Every scenario in three axes, with either tick: to the bit what one process plays, its proxies those of its shapes."""

from __future__ import annotations

from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from messages.topics import DEVICE_STATE, FORCE, PROXY
from nodes.compiled.choose_tick import choose
from nodes.environment.shapes.kinds import Touchable
from nodes.environment.surfaces import parse_surface
from nodes.launcher import launch_file
from nodes.recording.reader import Recording
from sim.cli.bench.loop import KERNELS
from sim.play.chain import SpatialTrace, play
from sim.play.touch import touch
from tests.support import slowly
from tests.support.launching import launch_json

WORDS = {"rough_plane": ("friction:=0.4",), "knob_turn": ("apply:=next_tick",)}
"""Beyond each scenario as it stands."""

LAUNCHES = {name: launch_file.read(name, {}) for name in launch_file.scenarios()}
SHAPES = [
    name
    for name, one in LAUNCHES.items()
    if "environment" in one.nodes
    and one.nodes["environment"].kind == "environment"
    and len(one.run.axes) == 3
]
MOVING = [
    name
    for name, one in LAUNCHES.items()
    if "environment" in one.nodes and one.nodes["environment"].kind == "mujoco"
]
TICKS = pytest.mark.parametrize("tick", slowly(["plain", "compiled"], but=["compiled"]))


@pytest.mark.process
def test_no_scenario_is_left_out() -> None:
    assert {"sphere_feel", "box_edges", "mesh_pebble", "rough_plane"} <= set(SHAPES)
    assert {"puck_push", "knob_turn", "stack_boxes"} <= set(MOVING)


@pytest.fixture(scope="module", autouse=True)
def compiled_before() -> None:
    """Compile the ticks before the clock of a launch runs."""
    told: list[str] = []
    assert (
        choose("compiled", (*KERNELS, "nodes.environment.shapes.kernel"), told.append) == "compiled"
    ), told


def words(scenario: str) -> list[str]:
    return [*WORDS.get(scenario, ()), "pace:=lockstep", "duration:=1.6"]


@cache
def played(scenario: str) -> SpatialTrace:
    """Play a scenario in one process: its states and rules are the nodes' own."""
    return play(launch_file.read(scenario, launch_file.parse_assignments(words(scenario))))


def launched(folder: Path, scenario: str, tick: str, compiled: set[str]) -> dict[str, list[Any]]:
    """Launch a scenario; its messages, after a comparison with those of one process."""
    figures = launch_json(folder, scenario, *words(scenario), "--tick", tick)
    ran = {name for name, one in figures["tick_by_node"].items() if one == "compiled"}
    assert ran & {"driver", "environment", "coupling"} == (
        compiled if tick == "compiled" else set()
    )
    recording = Recording(folder / figures["recording"])
    found = {topic: recording.messages(topic) for topic in (DEVICE_STATE, PROXY, FORCE)}
    states, proxies, alone = found[DEVICE_STATE], found[PROXY], played(scenario)
    assert [state.seq for state in states] == list(range(figures["ticks"] + 1))
    assert np.array_equal(alone.position, [state.position for state in states[:-1]])
    assert np.array_equal(alone.force, [state.force for state in states[1:]])
    assert np.array_equal(alone.contact, [message.contact for message in proxies[:-1]])
    assert np.array_equal(alone.proxy, [message.proxy for message in proxies[:-1]])
    # Something was felt.
    assert np.abs(alone.force).max() > 0.1
    return found


@pytest.mark.process
@pytest.mark.smoke("mesh_pebble-compiled")
@TICKS
@pytest.mark.parametrize("scenario", SHAPES)
def test_one_process_plays_the_same(scenario: str, tick: str, tmp_path: Path) -> None:
    found = launched(tmp_path, scenario, tick, {"driver", "environment", "coupling"})[PROXY]
    launch = launch_file.read(scenario, launch_file.parse_assignments(words(scenario)))
    surface = parse_surface(launch.nodes["environment"].parameters["surface"], "surface")
    assert isinstance(surface, Touchable)
    path = np.array([message.position for message in found])
    contact = np.array([message.contact for message in found])
    assert 0.1 < contact.mean() < 0.95
    # Led aside by what it touches: more than one axis moves.
    assert (np.ptp(path[contact], axis=0) > 1e-3).sum() >= 2
    # Interpreted here too: tests/nodes/environment/test_proxy.py holds that the compiled one gives
    # the same bits.
    alone = touch(
        surface.solids("surface"), path, surface.tool_radius, launch.run.period, interpreted=True
    )
    assert np.array_equal(alone.contact, contact)
    assert np.array_equal(
        np.where(contact[:, None], alone.proxy, path), [message.proxy for message in found]
    )
    assert np.array_equal(alone.normal, [message.normal for message in found])
    assert np.array_equal(alone.distance, [message.distance for message in found])


@pytest.mark.process
@pytest.mark.parametrize(
    ("scenario", "tick"),
    [
        *(pytest.param(name, "plain", marks=pytest.mark.slow) for name in MOVING),
        (MOVING[0], "compiled"),
    ],
)
@pytest.mark.skipif(
    find_spec("mujoco") is None,
    reason="the extra is not installed: pip install 'haptic-nodes[mujoco]'",
)
def test_one_process_plays_what_moves(scenario: str, tick: str, tmp_path: Path) -> None:
    """MuJoCo is called from Python: of its environment the tick is the plain one, whatever the others take.

    What the others compile is what they compile for the shapes: one launch tells that both kinds go
    together.
    """
    launched(tmp_path, scenario, tick, {"driver", "coupling"})
