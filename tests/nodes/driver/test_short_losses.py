"""Losses too short for the driver: the mailbox removes and restores forces by itself."""

from __future__ import annotations

import ctypes
import time
from pathlib import Path
from typing import Any

import pytest

from nodes.driver.hardware import mailbox
from nodes.driver.hardware.compile import servo_library
from nodes.driver.hardware.mailbox import Mailbox
from tests.support.devices import bench, needs_cc
from tests.support.launching import wait_for

FORCE = (0.5, -0.25, 1.0)


@needs_cc
def test_a_force_that_was_off_for_want_of_a_position_comes_back_by_a_ramp() -> None:
    """Each second without a position costs five of ramp; slow machines do not matter."""
    code: Any = servo_library(Path(mailbox.__file__).with_name("mailbox.c"))
    code.device_write.argtypes = [
        ctypes.c_int64,
        ctypes.POINTER(ctypes.c_double),
        ctypes.c_int64,
        ctypes.c_double,
    ]
    box: Any = Mailbox()
    box.turn[:] = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    box.deadline, box.peak, box.recovery = 1e9, 8.0, 10_000.0
    code.device_write(ctypes.addressof(box), (ctypes.c_double * 3)(*FORCE), 0, 0.0)

    def acts(blind: bool, after: float) -> tuple[float, ...]:
        out = (ctypes.c_double * 3)()
        box.looked_at = time.monotonic() - after
        assert bool(code.mailbox_force(ctypes.byref(box), out, int(blind))) is not blind
        return tuple(out)

    assert acts(False, 1.0) == FORCE
    assert acts(True, 1000.0) == (0.0, 0.0, 0.0)
    half = acts(False, 0.0)
    assert half == tuple((1.0 - box.owed / box.recovery) * force for force in FORCE)
    assert half[2] == pytest.approx(0.5, abs=0.01)
    assert acts(False, 2500.0)[2] == pytest.approx(0.75, abs=0.01)
    # No more than the whole ramp, which is over then.
    acts(True, 1e6)
    assert acts(False, 10_000.0) == FORCE


@needs_cc
def test_a_force_decided_before_the_device_let_go_is_not_played_and_the_next_one_ramps() -> (
    None
):
    """A process may stop between clock and write: only the servo loop can notice."""
    code: Any = servo_library(Path(mailbox.__file__).with_name("mailbox.c"))
    code.device_write.argtypes = [
        ctypes.c_int64,
        ctypes.POINTER(ctypes.c_double),
        ctypes.c_int64,
        ctypes.c_double,
    ]
    box: Any = Mailbox()
    box.turn[:] = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    # The times are so long that a slow machine does not matter.
    box.deadline, box.peak, box.recovery = 100.0, 8.0, 10_000.0
    out = (ctypes.c_double * 3)()

    def written(decided: float, held_up: float = 0.0) -> tuple[float, ...]:
        """Write a force decided at a time, while the servo loop is stopped too."""
        box.decided_at = decided
        box.commanded_at -= held_up
        code.device_write(ctypes.addressof(box), (ctypes.c_double * 3)(*FORCE), 0, 0.0)
        code.mailbox_force(ctypes.byref(box), out, 0)
        return tuple(out)

    now = time.monotonic()
    assert written(now) == FORCE
    # Decided in the tick before the stop of 300 s, after 100 of which the device had let go.
    assert written(now - 299.0, held_up=300.0) == (0.0, 0.0, 0.0)
    assert box.let_go == 1
    assert written(now - 201.0) == (0.0, 0.0, 0.0)
    # The next sample was taken after it: its driver may not know, so its force begins from nothing.
    after = written(time.monotonic())
    assert 0.0 < after[2] < 0.01 * FORCE[2]
    # A force after a silence that the driver knows of is played as it is: its ramp is the driver's.
    box.owed = 0.0
    box.commanded_at -= 300.0
    code.mailbox_force(ctypes.byref(box), out, 0)
    assert tuple(out) == (0.0, 0.0, 0.0)
    assert written(time.monotonic()) == FORCE


@needs_cc
@pytest.mark.parametrize(
    ("kind", "call"),
    [
        ("force_dimension_driver", "dhdGetPosition"),
        pytest.param("inverse3_driver", "state", marks=pytest.mark.process),
    ],
)
def test_on_a_device_too(kind: str, call: str, tmp_path: Path) -> None:
    with bench(kind, tmp_path) as stand:
        device = stand.opened()
        device._box.recovery = 1.0
        # A pause of this test on a busy machine is no silence, after which a whole ramp is owed.
        device._box.deadline = 60.0
        stand.press(device, FORCE)
        stand.world.fail(call)

        def pushed() -> float:
            device.write_force(FORCE, 0, 0.0)
            return float(stand.world.force()[2])

        # Until the whole ramp is owed, so that there is a second to see it.
        wait_for(
            lambda: pushed() == 0.0 and device._box.owed == device._box.recovery,
            "no position, no force",
        )
        stand.world.fail("")
        came = 0.0

        def comes_back() -> bool:
            nonlocal came
            came = pushed()
            return came > 0.0

        wait_for(comes_back, "the force comes back")
        assert came < FORCE[2]
        wait_for(
            lambda: pushed() == pytest.approx(FORCE[2], abs=1e-12), "the whole of it"
        )
        device.close()


@needs_cc
def test_a_force_dimension_lets_go_by_its_thread_before_its_firmware_does(
    tmp_path: Path,
) -> None:
    """The driver must know the earlier time, from which a force returns by a ramp."""
    with bench("force_dimension_driver", tmp_path) as stand:
        device = stand.device(deadline=0.01, watchdog=0.03)
        device.connect()
        assert (device.limits.hold, device.limits.lets_go) == (0.03, 0.01)
