"""What a run is given besides its law acts alike on the nodes and in one process."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from nodes.launcher import launch_file
from nodes.parameters.store import ParameterError
from sim.play.chain import Instead
from sim.play.given import Given
from sim.play.launched import NotOneAxisError, from_launch
from sim.play.player import How, play

TICKS = 400
WAYS: tuple[How, ...] = ("fastest", "interpreted", "nodes")


def some(seed: int, size: float) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    return np.random.default_rng(seed).normal(0.0, size, TICKS)


def jumps() -> Given:
    """Return jumps of position, velocity and reading at some ticks."""
    nudged = np.zeros((TICKS, 3))
    nudged[::37] = (1e-5, 1e-3, 2e-6)
    return Given(nudged=nudged)


GIVEN: dict[str, tuple[str, Callable[[], Given]]] = {
    "force": ("wall_press", lambda: Given(force=some(1, 0.3))),
    "target": ("wall_press", lambda: Given(target=0.02 + some(2, 1e-3))),
    "nudged": ("floor_drop", jumps),
    "force and target": (
        "wall_press",
        lambda: Given(force=some(3, 0.3), target=some(4, 0.02)),
    ),
}


@pytest.mark.parametrize("name", GIVEN)
@pytest.mark.parametrize("apply", ["on_arrival", "next_tick"])
def test_what_is_given_acts_the_same_however_it_is_played(
    name: str, apply: str
) -> None:
    scenario, make = GIVEN[name]
    launch = launch_file.read(scenario, {"apply": apply})
    bare = play(launch, ticks=TICKS)
    traces = [play(launch, ticks=TICKS, given=make(), how=how) for how in WAYS]
    for trace in traces[1:]:
        for row in ("position", "velocity", "measured", "force", "final"):
            assert np.array_equal(getattr(trace, row), getattr(traces[0], row)), row
    assert not np.array_equal(traces[0].position, bare.position)


def test_a_law_and_swaps_in_place_of_the_launch_files_own_render_the_same() -> None:
    launch = launch_file.read("floor_drop", {})
    other = from_launch(
        launch_file.read("floor_swap", {"first": 0.2, "second": 0.5, "ramp": 20})
    )
    instead = Instead(law=other.law, swaps=other.swaps)
    first, *others = (
        play(launch, ticks=TICKS, instead=instead, how=how) for how in WAYS
    )
    for trace in others:
        assert np.array_equal(trace.force, first.force)
        assert trace.law == first.law
    assert [first.law[k] for k in (0, 100, 250)] == ["given", "given_1", "given_2"]


def test_a_force_on_a_free_device_in_space_moves_it_by_newtons_law() -> None:
    """Beside the hand, which pulls in both runs alike: m x'' + b x' = F over the first ticks."""
    launch = launch_file.read("free_space", {})
    force = np.zeros((TICKS, 3))
    force[:, 0] = 0.01
    pushed = play(launch, ticks=TICKS, given=Given(force=force), how="nodes")
    still = play(launch, ticks=TICKS, how="nodes")
    device = from_launch(launch).scene.device
    # From rest x = (F t² / 2 m) (1 − b t / 3 m + …): the damper takes off that part, the
    # spring k t² / 12 m, and no more.
    t = 3 * launch.run.period
    damped = device.moving_damping * t / (3.0 * device.moving_mass)
    sprung = device.grip * t**2 / (12.0 * device.moving_mass)
    moved = pushed.position[3, 0] - still.position[3, 0]
    assert moved == pytest.approx(
        0.5 * 0.01 * t**2 / device.moving_mass * (1.0 - damped),
        rel=damped**2 + 1.1 * sprung,
    )


@pytest.mark.parametrize(
    ("scenario", "given", "told"),
    [
        ("sphere_feel", Given(force=np.zeros(TICKS)), r"given\.force: shape \(400,\)"),
        ("floor_drop", Given(path=np.zeros((10, 3))), r"given\.path: shape \(10, 3\)"),
        ("hands_coupled", Given(force=np.zeros(TICKS)), "given to one virtual device"),
        (
            "sphere_feel",
            Given(arrivals=(np.zeros(1), np.zeros(1, dtype=np.int64), np.zeros(1))),
            "not one axis",
        ),
    ],
)
def test_what_cannot_be_given_is_refused_with_its_shape(
    scenario: str, given: Given, told: str
) -> None:
    with pytest.raises(ParameterError, match=told):
        play(launch_file.read(scenario, {}), ticks=TICKS, given=given)


def test_a_longer_run_than_one_process_keeps_is_refused() -> None:
    launch = launch_file.read("floor_drop", {})
    with pytest.raises(ParameterError, match="10000001 ticks, limit 10000000"):
        play(launch, ticks=10_000_001)


def test_more_than_one_axis_is_no_scene_of_the_fast_loop() -> None:
    for name in ("sphere_feel", "hands_coupled", "world_feel"):
        with pytest.raises(NotOneAxisError):
            from_launch(launch_file.read(name, {}))
