"""The device contract for the virtual device with one and three axes (test_contract.py).

It runs in the driver's ticks, so time passes with them here. `faulty_driver` provides the faults.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import pytest

from messages.types import Vector
from nodes.base.node_kinds import NODES
from nodes.driver.device import Device
from nodes.driver.hardware.driver import HardwareDriver
from nodes.driver.node import Driver
from nodes.driver.paired.paired_device import PairedDevice
from nodes.parameters.store import ParameterError, convert
from sim.device.driver import SimDevice, SimDriverParameters
from sim.device.model import DeviceModel
from sim.drill.faulty_device import BLOCKS, FAILS, FaultyDevice
from tests.support import ROOT
from tests.support.contract import CALLS, checks
from tests.support.devices import real_devices
from tests.support.setups import setup_of

HOLD, PERIOD, PEAK = 0.05, 0.002, 7.9
HELD = round(HOLD / PERIOD)
AXES = {"one axis": ["z"], "three axes": ["x", "y", "z"]}
VIRTUAL = {
    "sim_driver": "the virtual device, of one axis and of three",
    "faulty_driver": "the virtual device that misbehaves on command",
    "paired_driver": "two devices, each with a contract of its own",
}
"""Every registered kind of virtual driver, and its representative in the contract."""


class VirtualBench(NamedTuple):
    """A virtual device, ready to be driven and disturbed.

    Attributes
    ----------
    device : Device
        What the driver calls.
    sim : SimDevice
        What stands behind it.
    axes : list of int
        The axes that it has.
    order : Path
        As long as it exists, the device does what it says.
    """

    device: Device
    sim: SimDevice
    axes: list[int]
    order: Path

    def acting(self) -> list[float]:
        """Return the forces acting on it now [N]."""
        return [float(part.state.acting) for part in self.sim.parts]

    def push(self, force: float, seq: int) -> None:
        """Push along all of its axes."""
        self.device.write_force((force, force, force), seq, 0.0)


@pytest.fixture(params=list(AXES))
def virtual(request: pytest.FixtureRequest, tmp_path: Path) -> VirtualBench:
    axes: Any = AXES[request.param]
    device: dict[str, Any] = {
        "mass": 0.1,
        "damping": 0.0,
        "position": 0.01,
        "peak_force": PEAK,
    }
    parameters = msgspec.convert({"device": device, "hold": HOLD}, SimDriverParameters)
    sim = SimDevice(parameters.device, setup_of(axes=axes), HOLD)
    order = tmp_path / "order"
    return VirtualBench(
        FaultyDevice(sim, str(order)), sim, ["xyz".index(axis) for axis in axes], order
    )


def start(virtual: VirtualBench) -> Vector:
    """Return its initial position: the first axis of the scene has the parameter's."""
    place = [0.0, 0.0, 0.0]
    place[virtual.axes[0]] = 0.01
    return place[0], place[1], place[2]


def test_position_before_force(virtual: VirtualBench) -> None:
    virtual.device.open()
    assert virtual.device.read_position(0) == start(virtual)
    assert not any(virtual.acting())


def test_forces_off_until_asked_for(virtual: VirtualBench) -> None:
    virtual.device.open()
    for seq in range(100):
        # Nothing else pulls at it: not a bit changes.
        assert virtual.device.read_position(seq) == start(virtual)
    virtual.push(1.0, 100)
    virtual.device.read_position(101)
    assert virtual.acting() == [1.0] * len(virtual.axes)


def test_limits_are_read_and_kept(virtual: VirtualBench) -> None:
    assert virtual.device.limits.hold == HOLD
    assert virtual.device.limits.latency == 0.0
    virtual.device.read_position(0)
    virtual.push(1e6, 0)
    found = virtual.device.read_position(1)
    for axis in virtual.axes:
        # No damping: ½ F/m T² of what the motor gives, and a sum with 0.01 m.
        assert found[axis] - start(virtual)[axis] == pytest.approx(
            0.5 * PEAK / 0.1 * PERIOD**2, rel=1e-12
        )
    virtual.push(math.nan, 1)
    assert all(map(math.isfinite, virtual.device.read_position(2)))
    assert not any(virtual.acting())


def test_silence_ends_the_force_within_hold(virtual: VirtualBench) -> None:
    virtual.device.read_position(0)
    virtual.push(1.0, 0)
    virtual.device.read_position(HELD)
    assert virtual.acting() == [1.0] * len(virtual.axes)
    virtual.device.read_position(HELD + 1)
    assert not any(virtual.acting())


def test_unplugged_it_says_so_and_ends_safely(virtual: VirtualBench) -> None:
    virtual.device.read_position(0)
    virtual.push(1.0, 0)
    virtual.order.write_text(f"{FAILS}read_position", encoding="ascii")
    with pytest.raises(OSError, match="unplugged"):
        virtual.device.read_position(1)
    virtual.device.close()
    # Its own deadline counts on.
    virtual.sim.read_position(HELD + 2)
    assert not any(virtual.acting())


def test_a_read_that_blocks_holds_up_nobody(virtual: VirtualBench) -> None:
    """The driver waits, but the device releases the force for the hand."""
    virtual.device.read_position(0)
    virtual.push(1.0, 0)
    virtual.order.write_text(f"{BLOCKS}0.1", encoding="ascii")
    # So many ticks have passed when it comes back.
    virtual.device.read_position(round(0.1 / PERIOD))
    assert not any(virtual.acting())
    moved = [part.state.v for part in virtual.sim.parts]
    # It was pushed for its hold, and not longer: F/m t.
    assert moved == pytest.approx(
        [1.0 / 0.1 * (HELD + 1) * PERIOD] * len(moved), rel=2.0 / HELD
    )


def test_a_failed_read_is_no_zero(virtual: VirtualBench) -> None:
    virtual.order.write_text(f"{FAILS}read_position", encoding="ascii")
    with pytest.raises(OSError, match="read_position"):
        virtual.device.read_position(0)
    virtual.order.unlink()
    assert virtual.device.read_position(1) == start(virtual)


def test_nan_is_no_position(virtual: VirtualBench) -> None:
    virtual.order.write_text("nan", encoding="ascii")
    assert all(map(math.isnan, virtual.device.read_position(0)))
    virtual.order.unlink()
    assert virtual.device.read_position(1) == start(virtual)


def test_every_call_may_fail(virtual: VirtualBench) -> None:
    calls: dict[str, Callable[[], object]] = {
        "open": virtual.device.open,
        "read_position": lambda: virtual.device.read_position(1),
        "write_force": lambda: virtual.push(1.0, 1),
        "close": virtual.device.close,
    }
    for name, call in calls.items():
        virtual.order.write_text(f"{FAILS}{name}", encoding="ascii")
        with pytest.raises(OSError, match=name):
            call()
        virtual.order.unlink()
        assert not any(virtual.acting())


def test_closed_twice_is_closed(virtual: VirtualBench) -> None:
    virtual.device.close()
    virtual.device.open()
    virtual.device.close()
    virtual.device.close()


def test_the_wrong_device_first(virtual: VirtualBench) -> None:
    del virtual
    wrong = {"device": {"mass": 0.1}, "preset": "touch_z"}
    with pytest.raises(
        ParameterError, match=r"preset is 'touch_z', expected none or one of touch_x, "
    ):
        convert(wrong, SimDriverParameters, "driver")


HAS_NONE = {"remarks are no errors"}
"""Checks not applicable to the virtual device: it calls no library."""


def test_a_pair_ends_with_either_of_its_devices(virtual: VirtualBench) -> None:
    other = SimDevice(DeviceModel(mass=0.1), setup_of(axes=["z"]))
    pair = PairedDevice(virtual.device, other)
    pair.open()
    pair.read_position(0)
    virtual.order.write_text(f"{FAILS}read_position", encoding="ascii")
    with pytest.raises(OSError, match="unplugged"):
        pair.read_position(1)
    virtual.order.write_text(f"{FAILS}close", encoding="ascii")
    with pytest.raises(OSError, match="close"):
        pair.close()


def test_no_registered_device_is_left_out() -> None:
    """A new device needs a bench and its calls; a new kind of driver must be listed."""
    kinds, broken = NODES.all()
    assert not broken
    drivers = {
        name
        for name, kind in kinds.items()
        if isinstance(kind, type) and issubclass(kind, Driver)
    }
    real = {name for name in drivers if issubclass(kinds[name], HardwareDriver)}
    assert drivers - real == set(VIRTUAL)
    assert real == set(CALLS)
    assert real == set(real_devices())
    # The virtual device has every check of a real one, but for what it cannot have.
    of_pairs = {"a pair ends with either of its devices"}
    assert checks(Path(__file__)) - of_pairs | HAS_NONE == checks(
        Path(__file__).with_name("test_contract.py")
    )
    page = (ROOT / "nodes" / "driver" / "DEVICES.md").read_text(encoding="utf-8")
    head = next(line for line in page.splitlines() if line.startswith("| check |"))
    assert {name.strip(" `") for name in head.strip("|").split("|")[1:]} == {
        *real,
        "sim_driver",
    }
