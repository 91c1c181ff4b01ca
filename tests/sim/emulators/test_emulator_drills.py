"""Faults of the driver's process over an emulator: the device's own last line holds."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from tests.support import slowly
from tests.support.devices import SOFT, bench, through
from tests.support.launching import running, wait_for


@pytest.mark.process
@pytest.mark.realtime
@pytest.mark.parametrize(
    "kind",
    slowly(["force_dimension_driver", "inverse3_driver"], but=["inverse3_driver"]),
)
def test_a_driver_that_is_stopped_or_killed_leaves_no_force(
    kind: str, tmp_path: Path
) -> None:
    """The firmware's watchdog, and the service's expiry; a Touch has neither."""
    with bench(kind, tmp_path) as stand:
        stand.world.state.position[2] = -0.002

        def pushes() -> bool:
            return stand.world.force()[2] == pytest.approx(0.3, abs=1e-9)

        with running(
            tmp_path, through(stand, tmp_path), *SOFT, "duration:=0"
        ) as launch:
            wait_for(pushes, "2 mm of 150 N/m")
            driver = launch.pid("driver")
            os.kill(driver, signal.SIGSTOP)
            wait_for(
                lambda: not any(stand.world.force()),
                "no force from a process that stands still",
            )
            os.kill(driver, signal.SIGCONT)
            wait_for(pushes, "the force again")
            # A coupling that is gone: the driver damps, then gives nothing.
            os.kill(launch.pid("coupling"), signal.SIGKILL)
            wait_for(lambda: not any(stand.world.force()), "no force without a law")
            launch.finish(code=1)
        (tmp_path / "run.mcap").unlink()
        with running(
            tmp_path, through(stand, tmp_path), *SOFT, "duration:=0"
        ) as launch:
            wait_for(pushes, "2 mm of 150 N/m")
            os.kill(launch.pid("driver"), signal.SIGKILL)
            wait_for(
                lambda: not any(stand.world.force()),
                "no force from a process that is gone",
            )
            launch.finish(code=1)
