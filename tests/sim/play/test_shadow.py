"""A | B: a second law under a running launch's hand, with the bits of a played one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from nodes.launcher import launch_file
from sim.experiments.term_scene import term_scene, with_drivers, with_parameters
from sim.play.given import Given
from sim.play.hops import setup_of
from sim.play.player import How, play
from sim.play.shadow import play_beside

TARGETS = [0.0] * 20 + [0.024] * 200 + [0.0] * 80
LAW: dict[str, Any] = {"kind": "pd", "stiffness": 2500.0, "damping": 3.0}


@pytest.mark.parametrize("late", [0.0, 0.23, 1.0 / 3.0])
def test_b_has_the_bits_of_a_run_with_that_hand_and_law(late: float) -> None:
    launch = launch_file.read("touch_wall", {})
    setups = {name: setup_of(launch, name) for name in launch.nodes}
    measured, force = play_beside(setups, LAW, TARGETS, (0.001, 0.02), late)

    scene = term_scene(launch)
    given = launch.nodes["driver"].parameters
    hand = {
        **given["device"]["hand"],
        "path": [[k * 0.002, x] for k, x in enumerate(TARGETS)],
    }
    begun = {"position": 0.001, "velocity": 0.02, "delay": late, "hand": hand}
    safety = {**given["safety"], "ramp": 0.0}
    scene = with_drivers(
        scene, [{"device": {**given["device"], **begun}, "safety": safety}]
    )
    coupling = {"law": "alone", "laws": {"alone": LAW}, "ease": 0.0}
    scene = with_parameters(scene, "coupling", coupling)
    ways: tuple[How, ...] = ("fastest", "nodes")
    for how in ways:
        alone = play(scene.launch, ticks=len(TARGETS), how=how).along()
        assert np.array_equal(alone.measured, measured)
        assert np.array_equal(alone.force, force)
    assert force.min() < -0.3


def test_b_played_in_parts_begins_as_it_does_at_once() -> None:
    launch = launch_file.read("touch_wall", {})
    setups = {name: setup_of(launch, name) for name in launch.nodes}
    whole = play_beside(setups, LAW, TARGETS, (0.0, 0.0), 0.23)
    part = play_beside(setups, LAW, TARGETS[:150], (0.0, 0.0), 0.23)
    for all_of_it, some in zip(whole, part, strict=True):
        assert np.array_equal(all_of_it[:150], some)


def test_b_in_three_axes_has_the_bits_of_a_run_with_that_hand_and_law() -> None:
    """Along a ball with friction, from a place and a speed of its own on each axis."""
    launch = launch_file.read("sphere_feel", {"friction": 0.3})
    setups = {name: setup_of(launch, name) for name in launch.nodes}
    ticks = 400
    targets = np.zeros((ticks, 3))
    targets[:, 0] = np.linspace(0.0, 0.06, ticks)
    begin = (0.001, -0.002, 0.0005), (0.02, 0.01, -0.03)
    hand: Any = targets.tolist()
    measured, force = play_beside(setups, LAW, hand, begin, 0.23)

    scene = term_scene(launch)
    given = launch.nodes["driver"].parameters
    x, y, z = (
        {"position": place, "velocity": speed}
        for place, speed in zip(*begin, strict=True)
    )
    device = {**given["device"], **x, "axes": {"y": y, "z": z}, "delay": 0.23}
    safety = {**given["safety"], "ramp": 0.0}
    scene = with_drivers(scene, [{"device": device, "safety": safety}])
    coupling = {"law": "alone", "laws": {"alone": LAW}, "ease": 0.0}
    scene = with_parameters(scene, "coupling", coupling)
    alone = play(scene.launch, ticks=ticks, given=Given(target=targets))
    assert np.array_equal(alone.measured, measured)
    assert np.array_equal(alone.force, force)
    assert np.abs(force).max(axis=0).min() > 0.1
