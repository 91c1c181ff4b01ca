"""A virtual device with different axes: each moves as its own device; checks per axis."""

from __future__ import annotations

from typing import Any

import pytest

from nodes.base.setup import Setup
from nodes.parameters.store import ParameterError
from sim.device.driver import SimDevice, SimDriver, along
from sim.device.model import DeviceModel
from sim.device.state import VirtualDevice, device_tick, measured

PERIOD = 0.002
HAND = {
    "stiffness": 150.0,
    "mass": 0.05,
    "damping": 2.0,
    "path": [(0.0, 0.0), (0.1, 0.02)],
}
AXES: dict[str, dict[str, Any]] = {
    "y": {
        "mass": 0.3,
        "resolution": 1e-5,
        "hand": {"path": [(0.0, 0.0), (0.05, -0.01)]},
    },
    "z": {"damping": 4.0, "position": 0.01, "hand": None},
}


def setup(axes: list[str], device: dict[str, Any]) -> Setup:
    return Setup(
        run="",
        run_dir="",
        factory="",
        publish="",
        control="",
        name="driver",
        kind="sim_driver",
        period=PERIOD,
        pace="lockstep",
        apply="on_arrival",
        axes=axes,  # type: ignore[arg-type]
        ticks=10,
        sources={},
        parameters={"device": device},
    )


def test_each_axis_moves_as_a_device_of_its_own() -> None:
    model = DeviceModel(mass=0.1, damping=1.0, gravity=9.81, hand=HAND, axes=AXES)  # type: ignore[arg-type]
    whole = SimDevice(model, setup(["x", "y", "z"], {}))
    still = {**HAND, "path": [(0.0, -0.0), (0.05, -0.01)]}
    alone = {
        "x": DeviceModel(mass=0.1, damping=1.0, hand=HAND),  # type: ignore[arg-type]
        "y": DeviceModel(mass=0.3, damping=1.0, resolution=1e-5, hand=still),  # type: ignore[arg-type]
        "z": DeviceModel(mass=0.1, damping=4.0, gravity=9.81, position=0.01),
    }
    parts = [VirtualDevice(device, PERIOD) for device in alone.values()]
    for seq in range(100):
        assert whole.read_position(seq) == tuple(measured(part.state) for part in parts)
        force = (0.1, -0.2, 1.0 if seq % 7 else -0.5)
        whole.write_force(force, seq, 0.0)
        for part, value in zip(parts, force, strict=True):
            device_tick(part.state, value)
    assert len(set(whole.read_position(100))) == 3


def test_an_axis_of_a_scene_with_one_is_the_device_there() -> None:
    model = DeviceModel(mass=0.1, axes={"z": {"mass": 0.2}})
    assert along(model, ["z"]) == [DeviceModel(mass=0.2)]
    assert along(model, ["x"]) == [DeviceModel(mass=0.1)]


@pytest.mark.parametrize(
    ("axes", "told"),
    [
        ({"w": {"mass": 0.1}}, "axes"),
        ({"y": {"mass": -0.1}}, r"axes.y.mass.*above 0"),
        ({"y": {"weight": 1.0}}, r"axes.y.*weight"),
        ({"y": {"position": 0.5}}, r"driver.device.axes.y.position: 0.5 m, expected"),
        ({"z": {"mass": 0.2}}, r"driver.device.axes.z: the scene computes x, y only"),
        ({"y": {"axes": {}}}, "axes.y"),
    ],
)
def test_what_cannot_be_is_refused(axes: dict[str, Any], told: str) -> None:
    given = {
        "device": {"mass": 0.1, "axes": axes},
        "safety": {"workspace": [[-0.1, 0.1]] * 3, "peak_force": 1.0},
    }
    with pytest.raises(ParameterError, match=told):
        SimDriver.check(
            Setup(
                **{
                    **{
                        f: getattr(setup(["x", "y"], {}), f)
                        for f in Setup.__struct_fields__
                    },
                    "parameters": given,
                }
            )
        )
