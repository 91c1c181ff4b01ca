"""The stiffness at which processes stop settling equals that of one process exactly."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nodes.driver.passivity import PassivityParameters
from nodes.laws.fir import FIR
from nodes.laws.parse import parse_law
from nodes.laws.pd import PD
from sim.device.hand import Hand
from sim.device.model import DeviceModel
from sim.experiments.drop import drop_scene, free_scene
from sim.experiments.k_max_launched import (
    compiled,
    last_settling,
    launched,
    parameters,
    same_k_max,
    settles_launched,
    with_stiffness,
)
from sim.experiments.k_max_simulated import simulated_k_max
from sim.experiments.settling import Criterion, settled, settles
from sim.play.one_axis import run
from sim.play.one_axis_inputs import Scene
from tests.support.launching import haptic

T = 0.002
SHORT = Criterion(ticks=1200)
"""2.4 s at 500 Hz: the drop takes 0.05 s; a swing at the end is above the limit."""


def dropped(delay: float = 0.0) -> Scene:
    return drop_scene(
        DeviceModel(mass=0.1, damping=1.0, delay=delay), T, raw=False, clamp=True
    )


@pytest.mark.process
def test_settles_just_inside_and_not_just_outside() -> None:
    """Found in one process to 0.1 %, tried with processes on both sides."""
    law, scene = PD(stiffness=1.0, damping=3.0), dropped(delay=1.0)
    found = simulated_k_max(
        lambda K: compiled(scene, with_stiffness(law, K)), scene, SHORT
    )
    assert found.k_max_n_per_m is not None
    assert found.unsettled_n_per_m is not None
    assert found.unsettled_n_per_m < 1.0011 * found.k_max_n_per_m
    assert settles_launched(scene, with_stiffness(law, found.k_max_n_per_m), SHORT)
    assert not settles_launched(
        scene, with_stiffness(law, found.unsettled_n_per_m), SHORT
    )


@pytest.mark.slow
def test_both_bisect_to_the_same_stiffness() -> None:
    """The paper's optimum, half a tick late: four taps, and two forces per tick."""
    law, scene = (
        parse_law({"kind": "paper_optimum", "stiffness": 1.0}),
        dropped(delay=0.5),
    )
    guess = simulated_k_max(
        lambda K: compiled(scene, with_stiffness(law, K)), scene, SHORT, low=500.0
    ).k_max_n_per_m
    assert guess is not None
    # 8 steps of 1.3 %, placed so that the boundary is not in the middle.
    grid = (guess * np.geomspace(0.93, 1.03, 9)).tolist()
    found = same_k_max(law, scene, SHORT, grid)
    assert found.launched_n_per_m == found.one_process_n_per_m
    assert found.launched_n_per_m is not None
    # The guess settles and 1.001 times it does not: it is less than a step above what was found.
    assert (
        grid[0]
        < found.launched_n_per_m
        < guess * 1.001
        < found.launched_n_per_m * 1.001 * grid[1] / grid[0]
    )
    assert found.launches == 5  # both ends, and log2(8)


@pytest.mark.process
def test_recorded_run_is_the_trace_and_is_judged_alike() -> None:
    """A free swing about an anchor in a hand: other surface, convention and load."""
    hand = Hand(mass=0.05, damping=0.5, stiffness=50.0, path=[(0.0, 0.0)])
    scene = free_scene(DeviceModel(mass=0.1, damping=1.0, delay=0.3, hand=hand), T)
    law = with_stiffness(PD(stiffness=1.0, damping=2.0), 800.0)
    position, force = launched(scene, law, SHORT.ticks)
    trace = run(scene, compiled(scene, law), SHORT.ticks)
    assert position.tolist() == trace.position.tolist()
    assert force.tolist() == trace.force.tolist()
    assert (
        settled(scene, compiled(scene, law), position, force, SHORT)
        == settles(scene, [compiled(scene, law)], SHORT)[0]
    )


@pytest.mark.parametrize("stiffness", [500.0, 2000.0, 2500.0, 3000.0, 4000.0, 12000.0])
def test_a_run_judged_alone_is_judged_as_among_many(stiffness: float) -> None:
    scene, law = dropped(), PD(stiffness=stiffness, damping=3.0).compile(T)
    trace = run(scene, law, SHORT.ticks)
    assert (
        settled(scene, law, trace.position, trace.force, SHORT)
        == settles(scene, [law], SHORT)[0]
    )


@given(st.integers(1, 200), st.integers(0, 201))
def test_bisection_finds_the_last_that_settles(count: int, good: int) -> None:
    grid = [float(i) for i in range(count)]
    asked: list[float] = []

    def verdict(stiffness: float) -> bool:
        asked.append(stiffness)
        return stiffness < good

    expected = None if good == 0 else math.inf if good >= count else float(good - 1)
    assert last_settling(verdict, grid) == expected
    assert len(asked) <= 2 + math.ceil(math.log2(max(count - 1, 1)))


def test_what_the_launch_does_not_play_is_refused() -> None:
    guarded = Scene(
        **{**vars(dropped()), "passivity": PassivityParameters(stiffness=1000.0)}
    )
    with pytest.raises(ValueError, match="no guard"):
        parameters(guarded, {"kind": "pd"})
    with pytest.raises(ValueError, match="fir has no nominal stiffness"):
        with_stiffness(FIR(taps=(1000.0,)), 500.0)
    short = run(dropped(), PD(stiffness=900.0, damping=3.0).compile(T), 100)
    with pytest.raises(
        ValueError, match="100 positions and 100 forces, the horizon is 1200 ticks"
    ):
        settled(
            dropped(),
            PD(stiffness=900.0).compile(T),
            short.position,
            short.force,
            SHORT,
        )


@pytest.mark.slow
def test_study_tells_both(tmp_path: Path) -> None:
    words = (
        "--law",
        "pd",
        "--gain",
        "3",
        "--method",
        "lockstep",
        "--horizon",
        "600",
        "--grid",
        "3",
        "--json",
    )
    figures = json.loads(
        haptic(tmp_path, "study", "kmax", *words).stdout.splitlines()[-1]
    )
    assert figures["same"] is True
    assert figures["k_max_n_per_m"] == figures["one_process_n_per_m"]
    # PD has no leak: its taps sum to K but for their rounding.
    assert figures["h1_max_n_per_m"] == pytest.approx(
        figures["k_max_n_per_m"], rel=1e-12
    )
    assert figures["launches"] == 3
    assert list(tmp_path.iterdir()) == []
    assert (
        "one --gain"
        in haptic(
            tmp_path, "study", "kmax", "--method", "lockstep", "--gain", "1..3", code=2
        ).stderr
    )
