"""Mapping into the scene: axes, equal power, limits, clutch, centre, handle."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np
import pytest

from nodes.driver.device import DeviceLimits
from nodes.driver.forcedimension.driver import inertia_in_scene
from nodes.driver.hardware.mapping import Mapping, limits_in_scene, matrix
from nodes.parameters.store import ParameterError
from tests.support.devices import Bench, bench
from tests.support.launching import wait_for
from tests.support.setups import setup_of

UPRIGHT = ("+x", "+y", "+z")
EPSILON = 1e-15  # of a few products of numbers near 1


@pytest.fixture
def stand(tmp_path: Path) -> Iterator[Bench]:
    with bench("touch_driver", tmp_path) as made:
        yield made


def test_axes_rotation_and_scale_are_one_matrix() -> None:
    assert matrix(Mapping(), ("-z", "-x", "+y")) == ((0, 0, -1), (-1, 0, 0), (0, 1, 0))
    turned = np.array(matrix(Mapping(rotation=(30.0, -20.0, 75.0), scale=2.5), UPRIGHT))
    # A turn times the scale: Mᵀ M = s² 1.
    assert turned.T @ turned == pytest.approx(2.5**2 * np.eye(3), abs=10 * EPSILON)
    assert np.linalg.det(turned) > 0.0
    # A quarter turn about z brings x to y, exactly.
    assert matrix(Mapping(rotation=(0.0, 0.0, 90.0)), UPRIGHT) == (
        (0, -1, 0),
        (1, 0, 0),
        (0, 0, 1),
    )


@pytest.mark.parametrize(
    "axes", [["+x", "+x", "+z"], ["+x", "+z", "+y"], ["-x", "+y", "+z"]]
)
def test_a_mirror_or_a_missing_axis_is_refused(axes: list[str]) -> None:
    with pytest.raises(
        msgspec.ValidationError, match=r"axes is .*: (each of x, y and z|a mirror)"
    ):
        msgspec.convert({"axes": axes}, Mapping)


def test_power_is_the_same_on_both_sides(stand: Bench) -> None:
    mapping = {
        "scale": 2.0,
        "rotation": [20.0, -35.0, 60.0],
        "centre": [0.1, 0.0, -0.05],
    }
    stand.world.state.peak = 100.0
    device = stand.opened(mapping)
    centre = np.array(device.read_position(0))
    assert centre == pytest.approx(mapping["centre"], abs=1e-12)
    move = np.array([0.01, -0.02, 0.005])
    stand.world.state.position[:] = list(move)
    wait_for(
        lambda: device.read_position(0) != tuple(centre), "the sample after the move"
    )
    scene = np.array(device.read_position(0)) - centre
    assert np.linalg.norm(scene) == pytest.approx(2.0 * np.linalg.norm(move), rel=1e-12)
    force = np.array([0.3, 0.2, -0.4])

    def arrives() -> bool:
        device.write_force((0.3, 0.2, -0.4), 0, 0.0)
        return any(stand.world.force())

    wait_for(arrives, "the force")
    assert np.linalg.norm(stand.world.force()) == pytest.approx(
        2.0 * np.linalg.norm(force), rel=1e-12
    )
    # Work of a move: in newtons and metres of the scene, and of the arm.
    assert np.array(stand.world.force()) @ move == pytest.approx(
        force @ scene, rel=1e-12
    )


def test_limits_hold_in_every_direction() -> None:
    box = ((-0.1, 0.1), (-0.2, 0.2), (-0.05, 0.15))
    limits = DeviceLimits(
        peak_force=6.0, continuous_force=2.0, hold=0.05, workspace=box
    )
    quarter = limits_in_scene(
        limits, m := Mapping(rotation=(0.0, 0.0, 90.0), scale=2.0), matrix(m, UPRIGHT)
    )
    assert (quarter.peak_force, quarter.continuous_force, quarter.hold) == (
        3.0,
        1.0,
        0.05,
    )
    assert quarter.workspace == ((-0.4, 0.4), (-0.2, 0.2), (-0.1, 0.3))
    askew = Mapping(rotation=(0.0, 0.0, 45.0))
    turn = np.array(matrix(askew, UPRIGHT))
    lowered = limits_in_scene(limits, askew, matrix(askew, UPRIGHT))
    # A force on all axes of the scene, each at its limit, is at most the limit on each axis of the
    # device.
    corners = (
        np.array(np.meshgrid(*[[-1.0, 1.0]] * 3)).reshape(3, -1) * lowered.peak_force
    )
    assert np.abs(turn.T @ corners).max() == pytest.approx(6.0, rel=10 * EPSILON)
    assert limits_in_scene(
        limits, c := Mapping(clutch=0, reach=0.3), matrix(c, UPRIGHT)
    ).workspace[0] == (-0.4, 0.4)


def test_the_clutch_holds_the_scene_and_the_force_comes_back_by_a_ramp(
    stand: Bench,
) -> None:
    device = stand.opened({"clutch": 1, "clutch_ramp": 10.0, "reach": 0.05})
    w = stand.world.state

    def settles(wanted: tuple[float, float, float]) -> None:
        def there() -> bool:
            device.write_force((0.0, 0.0, 1.0), 0, 0.0)
            return device.read_position(0) == pytest.approx(wanted, abs=1e-12)

        wait_for(there, f"{wanted}, not {device.read_position(0)}")

    def pushed() -> float:
        device.write_force((0.0, 0.0, 1.0), 0, 0.0)
        return stand.world.force()[2]

    w.position[2] = 0.01
    settles((0.0, 0.0, 0.01))
    wait_for(lambda: pushed() == 1.0, "the force")
    w.buttons = 0b10
    wait_for(lambda: device.read_position(0) and device._box.held, "the clutch")
    w.position[2] = 0.04
    # The scene stands still, and the hand is free.
    settles((0.0, 0.0, 0.01))
    wait_for(lambda: pushed() == 0.0, "no force")
    ticks = device.ticks
    wait_for(lambda: device.ticks > ticks + 3, "samples of the new place")
    w.buttons = 0
    wait_for(
        lambda: device.read_position(0) and not device._box.held, "the clutch let go"
    )
    settles((0.0, 0.0, 0.01))
    w.position[2] = 0.05
    settles((0.0, 0.0, 0.02))
    # By a ramp of 10 s: it has only begun.
    wait_for(lambda: pushed() > 0.0, "it comes back")
    assert stand.world.force()[2] < 1.0
    # Another button is no clutch.
    w.buttons = 0b101
    w.position[2] = 0.06
    settles((0.0, 0.0, 0.03))


def test_the_centre_is_where_the_handle_stands(stand: Bench) -> None:
    stand.world.state.position[:] = (0.03, -0.02, 0.01)
    device = stand.opened({"recentre": True, "centre": [0.0, 0.0, 0.1], "scale": 3.0})
    assert device.read_position(0) == pytest.approx((0.0, 0.0, 0.1), abs=1e-12)
    stand.world.state.position[0] = 0.04
    wait_for(
        lambda: device.read_position(0) == pytest.approx((0.03, 0.0, 0.1), abs=1e-12),
        "three times as far",
    )
    device.recentre()
    assert device.read_position(0) == pytest.approx((0.0, 0.0, 0.1), abs=1e-12)


def test_the_workspace_moves_with_the_centre(
    stand: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The launch file's workspace is the scene's and stays; the device's own moves."""
    parameters = {
        **stand.written({"scale": 2.0}),
        "safety": {"hang": None, "workspace": [[-1.0, 1.0], [-1.0, 1.0], [-0.01, 1.0]]},
    }
    driver = stand.driver(
        setup_of(kind=stand.kind, axes=["x", "y", "z"], parameters=parameters)
    )
    driver.configure()
    stand.made.append(driver.held)
    driver.held.open()
    before = np.reshape(list(driver.driving.workspace), (3, 2))
    stand.world.state.position[:] = (0.03, -0.02, 0.01)
    wait_for(lambda: any(driver.held.read_position(0)), "the sample after the move")
    monkeypatch.setattr(driver.changes, "hand_over", lambda apply: apply(0))
    moved = np.array(driver.operations()["recentre"]()["moved_m"])
    assert moved == pytest.approx((-0.06, 0.04, -0.02), abs=1e-12)
    after = np.reshape(list(driver.driving.workspace), (3, 2))
    assert after[:2] == pytest.approx(before[:2] + moved[:2, None], abs=1e-12)
    assert after[2] == pytest.approx((-0.01, before[2, 1] + moved[2]), abs=1e-12)
    driver.driving.handed[0] = 0.1
    with pytest.raises(ParameterError, match="re-centre while no force acts"):
        driver.operations()["recentre"]()


def test_the_handle_turns_with_the_scene(stand: Bench) -> None:
    # The handle is turned by 90° about the device's own first axis; the columns of a turn, row by
    # row.
    stand.world.state.turn[:] = [1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0]
    stand.world.state.buttons = 3
    device = stand.opened()
    handle = device.handle()
    assert handle is not None
    half = math.sqrt(0.5)
    # HDAPI's +x is to the right: −y here.
    assert handle.orientation == pytest.approx(
        (0.0, -half, 0.0, half), abs=10 * EPSILON
    )
    assert handle.buttons == 3


def test_weights_are_told_to_the_library_before_forces_are_on(tmp_path: Path) -> None:
    with bench("force_dimension_driver", tmp_path) as stand:
        w = stand.world.state
        w.tool_mass = -1.0
        for carries, tool, base in (
            (True, None, (0.0, 0.0)),
            (False, 0.08, (90.0, -30.0)),
        ):
            device = stand.device(
                gravity_compensation=carries, tool_mass=tool, base_angles=list(base)
            )
            device.connect()
            assert w.forces == 0
            device.open()
            assert (bool(w.carries), tuple(w.base)) == (carries, base)
            # A mass that nobody gives is left as the device knows it.
            assert w.tool_mass == (-1.0 if tool is None else tool)
            device.close()


@pytest.mark.process
def test_the_gripper_and_the_buttons_of_each_kind_are_in_the_handle(
    tmp_path: Path,
) -> None:
    for kind, gripper, pressed in (
        ("force_dimension_driver", 0.012, 5),
        ("inverse3_driver", 0.0, 1),
    ):
        folder = tmp_path / kind
        folder.mkdir()
        with bench(kind, folder) as stand:
            stand.world.state.gripper, stand.world.state.buttons = 0.012, pressed
            device = stand.opened()
            handle = device.handle()
            assert handle is not None
            assert (handle.gripper, handle.buttons) == (gripper, pressed)
            device.close()


def test_inertia_keeps_its_energy() -> None:
    mapping = Mapping(rotation=(10.0, 20.0, 30.0), scale=2.0)
    turn = matrix(mapping, UPRIGHT)
    theirs = np.diag([0.1, 0.2, 0.3])
    ours = np.array(inertia_in_scene(theirs.tolist(), turn))
    velocity = np.array([0.3, -0.2, 0.1])
    scene = np.array(turn) @ velocity
    assert scene @ ours @ scene == pytest.approx(
        velocity @ theirs @ velocity, rel=10 * EPSILON
    )
