"""A tool that is led over shapes touches what the environment node touches, to the bit."""

from __future__ import annotations

import numpy as np
import pytest

from nodes.environment.shapes.touchable import Touchable
from nodes.environment.surfaces import parse_surface
from nodes.launcher import launch_file
from sim.play.player import play
from sim.play.touch import touch
from tests.support.launches import every_launch

LAUNCHES = every_launch()
SHAPES = [
    name
    for name, one in LAUNCHES.items()
    if "environment" in one.nodes
    and one.nodes["environment"].kind == "environment"
    and len(one.run.axes) == 3
]


def test_no_scenario_is_left_out() -> None:
    assert {"sphere_feel", "box_edges", "mesh_pebble", "rough_plane"} <= set(SHAPES)


@pytest.mark.parametrize("scenario", SHAPES)
def test_a_way_that_was_played_is_touched_the_same(scenario: str) -> None:
    """test_every_launch_file compares its player to the bit; this tests its shapes."""
    launch = launch_file.read(scenario, {"duration": 1.6})
    found = play(launch)
    surface = parse_surface(
        launch.nodes["environment"].parameters["surface"], "surface"
    )
    assert isinstance(surface, Touchable)
    path, contact = found.measured, found.contact
    assert 0.1 < contact.mean() < 0.95
    # Led aside by what it touches: more than one axis moves.
    assert (np.ptp(path[contact], axis=0) > 1e-3).sum() >= 2
    # Interpreted here: tests/nodes/environment/test_proxy.py holds that the compiled one gives the
    # same bits.
    alone = touch(
        surface.solids("surface"),
        path,
        surface.tool_radius,
        launch.run.period,
        interpreted=True,
    )
    assert np.array_equal(alone.contact, contact)
    assert np.array_equal(np.where(contact[:, None], alone.proxy, path), found.proxy)
    assert np.array_equal(alone.normal, found.normal)
