"""The Touch's driver on its emulator: calibration, axes, faults, refusals."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from nodes.driver.limits import SafetyParameters, lower
from nodes.driver.touch.driver import (
    TouchDevice,
    TouchDriverParameters,
    TouchParameters,
)
from nodes.recording.reader import Recording
from tests.support.devices import Bench, bench, needs_cc
from tests.support.launching import launch_json, running, wait_for


@pytest.fixture
def fake(tmp_path: Path) -> Iterator[Bench]:
    with bench("touch_driver", tmp_path) as made:
        yield made


def connected(path: Path | str, **parameters: Any) -> TouchDevice:
    device = TouchDevice(
        TouchDriverParameters(touch=TouchParameters(library=str(path), **parameters))
    )
    device.connect()
    return device


def test_what_is_waited_for_is_said_once() -> None:
    device, said = TouchDevice(TouchDriverParameters()), list[str]()
    device.say = said.append
    for what in ("the service", "the service", "calibration", "the service"):
        device.wait_for(what)
    assert said == ["Touch: the service", "Touch: calibration", "Touch: the service"]


@needs_cc
def test_calibration_comes_before_forces(fake: Bench) -> None:
    fake.world.state.forces = 1  # on by default in the vendor's library
    fake.world.state.calibrations = 2
    device = fake.device()
    device.connect()
    assert fake.world.state.forces == 0
    ends = [end for bounds in device.limits.workspace for end in bounds]
    assert ends == pytest.approx([-0.13, 0.085, -0.21, 0.21, -0.11, 0.205], abs=1e-15)
    assert (device.limits.peak_force, device.limits.continuous_force) == (7.9, 1.75)
    device.open()
    assert fake.world.state.calibrations == 0
    assert fake.world.state.style == 4  # inkwell rather than encoder reset
    assert fake.world.state.forces == 1
    device.close()
    assert fake.world.state.broken == 0


@needs_cc
@pytest.mark.parametrize(
    ("code", "name"),
    [
        (0x0200, "warm motors"),
        (0x0302, "communication error"),
        (0x0600, "invalid licence"),
        (0x0999, "error"),
    ],
)
def test_a_fault_of_the_device_ends_forces_and_is_told(
    fake: Bench, code: int, name: str
) -> None:
    device = fake.opened()
    fake.world.state.error = code
    told: list[str] = []

    def faulty() -> bool:
        device.write_force((0.0, 0.0, 1.0), 0, 0.0)
        try:
            device.read_position(0)
        except OSError as error:
            told.append(str(error))
        return bool(told)

    wait_for(faulty, "the fault is told")
    assert told[0].startswith(f"Touch: {name} (0x{code:04X}); forces are off")
    assert name in device.condition()
    wait_for(lambda: not any(fake.world.force()), "no force any more")


@needs_cc
def test_a_servo_thread_that_stands_still_is_told(fake: Bench) -> None:
    device = fake.opened(deadline=0.02)
    fake.world.state.frozen = 1

    def told() -> bool:
        try:
            device.read_position(0)
        except OSError as error:
            return "no sample for" in str(error) and "look at cable and power" in str(
                error
            )
        return False

    wait_for(told, "the driver notices")
    fake.world.state.frozen = 0


@needs_cc
def test_a_refused_rate_and_a_missing_calibration(fake: Bench) -> None:
    fake.world.state.refuse_rate = 1
    device = fake.opened(servo_rate=500, deadline=0.05)
    device.close()
    fake.world.state.manual = 1
    device = fake.device(calibration_time=0.0)
    device.connect()
    with pytest.raises(
        OSError,
        match=r"not calibrated within 0 s \(0x5002\): put the stylus into its inkwell",
    ):
        device.open()
    assert fake.world.state.forces == 0
    device.close()
    assert (fake.world.state.open, fake.world.state.broken) == (0, 0)


@pytest.mark.process
def test_a_missing_library_is_told_with_what_to_do() -> None:
    with pytest.raises(
        OSError,
        match=r"libHD\.so\.none cannot be loaded .*install OpenHaptics .* kind sim_driver",
    ):
        connected("libHD.so.none")


@needs_cc
def test_a_missing_device_and_a_wrong_library_are_told(
    fake: Bench, tmp_path: Path
) -> None:
    with pytest.raises(
        OSError,
        match=r"device absent cannot be opened: communication error \(0x0302\); is it plugged in",
    ):
        connected(fake.parameters["library"], name="absent")
    wrong = tmp_path / "wrong.so"
    subprocess.run(["cc", "-shared", "-o", wrong, "-x", "c", os.devnull], check=True)
    with pytest.raises(OSError, match="has no hdInitDevice: it is not HDAPI's library"):
        connected(wrong)


def test_no_launch_file_raises_the_limits_of_the_device() -> None:
    from nodes.driver.device import DeviceLimits

    device = DeviceLimits(peak_force=7.9, silence=0.1, hold=0.05)
    limits = lower(
        SafetyParameters(peak_force=100.0, watchdog=1000),
        device,
        0.002,
        "driver.safety",
    )
    assert (limits.peak, limits.watchdog) == (7.9, 50)
    assert (
        limits.overruled[0]
        == "driver.safety.peak_force: 100 N, limit 7.9 N of the device, which holds"
    )


def scenario(folder: Path, library: str) -> str:
    content = {
        "summary": "A Touch on a wall",
        "run": {"duration": 0.5},
        "nodes": {
            "driver": {
                "kind": "touch_driver",
                "parameters": {
                    "touch": {"library": library, "calibration_time": 0.1},
                    "safety": {"peak_force": 50.0},
                },
            },
            # The stand-in holds the arm at z = 22 mm, 1 mm inside this wall.
            "environment": {
                "kind": "environment",
                "parameters": {
                    "surface": {"kind": "plane", "axis": "z", "position": 0.023}
                },
            },
            "coupling": {
                "kind": "coupling",
                "parameters": {
                    "law": "pd",
                    "laws": {"pd": {"kind": "pd", "stiffness": 500.0}},
                },
            },
            "logger": {"kind": "logger", "parameters": {"path": "run.mcap"}},
        },
    }
    path = folder / "touch.yaml"
    path.write_bytes(msgspec.json.encode(content))
    return str(path)


@pytest.mark.process
@pytest.mark.smoke
@needs_cc
def test_a_whole_launch_on_the_stand_in(fake: Bench, tmp_path: Path) -> None:
    fake.world.state.position[2] = 0.022
    figures = launch_json(tmp_path, scenario(tmp_path, fake.parameters["library"]))
    assert figures["exit_reason"] == "done"
    assert figures["final"]["position_m"] == pytest.approx(0.022, abs=1e-12)
    assert figures["safety"]["told"] == [
        "driver.safety.peak_force: 50 N, limit 7.9 N of the device, which holds"
    ]
    recording = Recording(tmp_path / "run.mcap")
    assert recording.complete
    # On a busy machine forces may stop coming now and then; where they do come, they are K times 1
    # mm.
    pressing = {
        round(state.force[2], 9)
        for state in recording.messages("/device/state")
        if state.safety == "active"
    }
    assert 0.5 in pressing
    assert pressing <= {0.0, 0.5}


@pytest.mark.process
def test_a_launch_without_the_library_fails_with_the_reason(tmp_path: Path) -> None:
    with running(tmp_path, scenario(tmp_path, "libHD.so.none"), ready=False) as launch:
        figures = launch.finish(code=1)
        assert "[driver] cannot start: libHD.so.none cannot be loaded" in launch.errors
        assert "Traceback" not in launch.errors
        assert figures["ticks"] == 0


@pytest.mark.process
@needs_cc
def test_a_launch_with_an_uncalibrated_device_fails_with_the_remedy(
    fake: Bench, tmp_path: Path
) -> None:
    fake.world.state.manual = 1
    with running(
        tmp_path, scenario(tmp_path, fake.parameters["library"]), ready=False
    ) as launch:
        launch.finish(code=1)
        assert (
            "[driver] ended: Touch: not calibrated within 0.1 s (0x5002): put the stylus into its"
            " inkwell" in launch.errors
        )
        assert "Traceback" not in launch.errors
