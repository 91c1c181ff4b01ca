"""The Touch's driver against a stand-in library compiled here: order of calls, axes, deadline, faults, and clear refusals."""

from __future__ import annotations

import ctypes
import functools
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nodes.driver.limits import SafetyParameters, lower
from nodes.driver.touch.driver import TouchDevice, TouchParameters
from nodes.driver.touch.hdapi import Servo, servo_library, to_ours
from nodes.recording.reader import Recording
from tests.support import FIXTURES
from tests.support.launching import launch_json, running, wait_for

needs_cc = pytest.mark.skipif(
    shutil.which("cc") is None and shutil.which("gcc") is None and shutil.which("clang") is None,
    reason="no C compiler: neither the stand-in for libHD nor the servo loop can be built",
)


def stand_in(folder: Path, *options: str) -> Path:
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    assert compiler is not None
    path = folder / "libfakehd.so"
    source = FIXTURES / "fake_hd.c"
    subprocess.run([compiler, "-O1", "-shared", "-fPIC", "-pthread", *options, "-o", path, source], check=True)
    return path


@pytest.fixture
def fake(tmp_path: Path) -> tuple[Path, Any]:
    """Compile a fresh stand-in: its path, and the loaded library with its switches."""
    path = stand_in(tmp_path)
    return path, ctypes.CDLL(str(path))


def number(library: Any, name: str) -> Any:
    return ctypes.c_int.in_dll(library, name)


def vector(library: Any, name: str) -> tuple[float, ...]:
    return tuple((ctypes.c_double * 3).in_dll(library, name))


def connected(path: Path, **parameters: Any) -> TouchDevice:
    device = TouchDevice(TouchParameters(library=str(path), **parameters))
    device.connect()
    return device


finite = st.floats(-1e3, 1e3)


servo_code = functools.cache(servo_library)


@needs_cc
@settings(deadline=None)
@given(st.tuples(finite, finite, finite), st.tuples(finite, finite, finite))
def test_axes_turn_back_and_forth_and_keep_work(
    move: tuple[float, float, float], force: tuple[float, float, float]
) -> None:
    # Work does not depend on whose axes it is counted in: F·dx is the same, millimetres aside.
    servo, code = Servo(patience=1e9), servo_code()
    code.servo_put(ctypes.byref(servo), (ctypes.c_double * 3)(*move))
    device, position = ctypes.c_int64(ctypes.addressof(servo)), (ctypes.c_double * 3)()
    assert code.device_read(device, ctypes.c_int64(0), position) == 0
    assert tuple(position) == pytest.approx(to_ours(move), rel=1e-15)
    assert code.device_write(device, (ctypes.c_double * 3)(*force), ctypes.c_int64(0), ctypes.c_double(0.0)) == 0
    ours = sum(a * b for a, b in zip(force, position, strict=True))
    theirs = sum(a * b * 1e-3 for a, b in zip(servo.force, move, strict=True))
    assert ours == pytest.approx(theirs, abs=1e-9)  # sums of three products up to 1e3
    assert to_ours((0.0, 0.0, -1000.0)) == (1.0, 0.0, 0.0)  # away from the user is forward
    assert to_ours((-1000.0, 0.0, 0.0)) == (0.0, 1.0, 0.0)
    assert to_ours((0.0, 1000.0, 0.0)) == (0.0, 0.0, 1.0)


@needs_cc
def test_a_session_keeps_the_rules_of_hdapi(fake: tuple[Path, Any]) -> None:
    path, library = fake
    device = connected(path)
    assert number(library, "fake_force_output").value == 0  # on by default in the stand-in, off before anything else
    assert device.limits.workspace == ((-0.035, 0.035), (-0.08, 0.08), (-0.06, 0.06))
    assert (device.limits.peak_force, device.limits.continuous_force) == (7.9, 1.75)
    device.open()
    assert number(library, "fake_calibrations_needed").value == 0
    assert number(library, "fake_last_style").value == 4  # inkwell rather than encoder reset
    assert number(library, "fake_force_output").value == 1
    # 2 mm of calibration jump included.
    assert device.read_position(0) == pytest.approx((-0.030, -0.010, 0.022), abs=1e-12)

    def force_arrives() -> bool:
        device.write_force((1.0, 2.0, 3.0), 0, 0.0)
        return vector(library, "fake_force") == (-2.0, 3.0, -1.0)

    wait_for(force_arrives, "the servo thread takes the force")
    device.close()
    device.close()
    assert number(library, "fake_open").value == 0
    assert number(library, "fake_force_output").value == 0
    assert number(library, "fake_broken_rules").value == 0


@needs_cc
def test_the_servo_thread_lets_go_when_no_force_comes(fake: tuple[Path, Any]) -> None:
    path, library = fake
    device = connected(path, deadline=0.02)
    device.open()
    try:
        lets = device.let_go
        device.write_force((0.0, 0.0, 1.0), 0, 0.0)
        # Nobody writes any more: this thread could be stopped as well, the servo loop does not need it.
        wait_for(lambda: device.let_go > lets and vector(library, "fake_force") == (0.0, 0.0, 0.0), "it lets go")

        def back() -> bool:
            device.write_force((0.0, 0.0, 1.0), 0, 0.0)
            return vector(library, "fake_force") == (0.0, 1.0, 0.0)

        wait_for(back, "a fresh force acts again")
    finally:
        device.close()


@needs_cc
@pytest.mark.parametrize(
    ("code", "name"), [(0x0200, "warm motors"), (0x0302, "communication error"), (0x0999, "error")]
)
def test_a_fault_of_the_device_ends_forces_and_is_told(fake: tuple[Path, Any], code: int, name: str) -> None:
    path, library = fake
    device = connected(path)
    device.open()
    try:
        library.fake_push_error(code)
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
        wait_for(lambda: vector(library, "fake_force") == (0.0, 0.0, 0.0), "no force any more")
    finally:
        device.close()


@needs_cc
def test_a_servo_thread_that_stands_still_is_told(fake: tuple[Path, Any]) -> None:
    path, library = fake
    device = connected(path, deadline=0.02)
    device.open()
    try:
        number(library, "fake_frozen").value = 1

        def told() -> bool:
            try:
                device.read_position(0)
            except OSError as error:
                return "the servo thread has given no sample for" in str(error)
            return False

        wait_for(told, "the driver notices")
        number(library, "fake_frozen").value = 0
    finally:
        device.close()


@needs_cc
def test_a_refused_rate_and_a_missing_calibration(fake: tuple[Path, Any]) -> None:
    path, library = fake
    number(library, "fake_refuse_rate").value = 1
    device = connected(path, servo_rate=500, deadline=0.05)
    device.open()
    device.close()
    number(library, "fake_manual").value = 1
    device = connected(path, calibration_time=0.0)
    with pytest.raises(OSError, match=r"not calibrated within 0 s \(0x5002\): put the stylus into its inkwell"):
        device.open()
    assert number(library, "fake_force_output").value == 0
    device.close()
    assert number(library, "fake_open").value == 0
    assert number(library, "fake_broken_rules").value == 0


def test_a_missing_library_is_told_with_what_to_do() -> None:
    with pytest.raises(OSError, match=r"libHD\.so\.none cannot be loaded .*install OpenHaptics .* kind sim_driver"):
        connected(Path("libHD.so.none"))


@needs_cc
def test_a_missing_device_and_a_wrong_library_are_told(fake: tuple[Path, Any], tmp_path: Path) -> None:
    with pytest.raises(
        OSError, match=r"device absent cannot be opened: communication error \(0x0302\); is it plugged in"
    ):
        connected(fake[0], name="absent")
    wrong = tmp_path / "wrong.so"
    subprocess.run(["cc", "-shared", "-o", wrong, "-x", "c", os.devnull], check=True)
    with pytest.raises(OSError, match="has no hdInitDevice: it is not HDAPI's library"):
        connected(wrong)


def test_no_launch_file_raises_the_limits_of_the_device() -> None:
    from nodes.driver.device import DeviceLimits

    device = DeviceLimits(peak_force=7.9, silence=0.1, hold=0.05)
    limits = lower(SafetyParameters(peak_force=100.0, watchdog=1000), device, 0.002, "driver.safety")
    assert (limits.peak, limits.watchdog) == (7.9, 50)
    assert limits.told[0] == "driver.safety.peak_force: 100 N, limit 7.9 N of the device, which holds"


def scenario(folder: Path, library: str) -> str:
    content = {
        "summary": "A Touch on a wall",
        "run": {"duration": 0.5},
        "nodes": {
            "driver": {
                "kind": "touch_driver",
                "parameters": {"touch": {"library": library, "calibration_time": 0.1}, "safety": {"peak_force": 50.0}},
            },
            # The stand-in holds the arm at z = 22 mm, 1 mm inside this wall.
            "environment": {
                "kind": "environment",
                "parameters": {"surface": {"kind": "plane", "axis": "z", "position": 0.023}},
            },
            "coupling": {
                "kind": "coupling",
                "parameters": {"law": "pd", "laws": {"pd": {"kind": "pd", "stiffness": 500.0}}},
            },
            "logger": {"kind": "logger", "parameters": {"path": "run.mcap"}},
        },
    }
    path = folder / "touch.yaml"
    path.write_bytes(msgspec.json.encode(content))
    return str(path)


@needs_cc
def test_a_whole_launch_on_the_stand_in(fake: tuple[Path, Any], tmp_path: Path) -> None:
    figures = launch_json(tmp_path, scenario(tmp_path, str(fake[0])))
    assert figures["exit_reason"] == "done"
    assert figures["final"]["position_m"] == pytest.approx(0.022, abs=1e-12)
    assert figures["safety"]["told"] == ["driver.safety.peak_force: 50 N, limit 7.9 N of the device, which holds"]
    recording = Recording(tmp_path / "run.mcap")
    assert recording.complete
    # On a busy machine forces may stop coming now and then; where they do come, they are K times 1 mm.
    pressing = {round(state.force[2], 9) for state in recording.messages("/device/state") if state.safety == "active"}
    assert 0.5 in pressing
    assert pressing <= {0.0, 0.5}


def test_a_launch_without_the_library_fails_with_the_reason(tmp_path: Path) -> None:
    with running(tmp_path, scenario(tmp_path, "libHD.so.none"), ready=False) as launch:
        figures = launch.finish(code=1)
        assert "[driver] cannot start: libHD.so.none cannot be loaded" in launch.errors
        assert "Traceback" not in launch.errors
        assert figures["ticks"] == 0


@needs_cc
def test_a_launch_with_an_uncalibrated_device_fails_with_the_remedy(tmp_path: Path) -> None:
    library = stand_in(tmp_path, "-DMANUAL=1")
    with running(tmp_path, scenario(tmp_path, str(library)), ready=False) as launch:
        launch.finish(code=1)
        assert (
            "[driver] ended: Touch: not calibrated within 0.1 s (0x5002): put the stylus into its inkwell"
            in launch.errors
        )
        assert "Traceback" not in launch.errors
