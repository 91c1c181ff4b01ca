"""A hanging or slow device: the driver ends in time with a reason, and so does the launch."""

from __future__ import annotations

import re
import signal
from pathlib import Path

import pytest

from nodes.recording.reader import Recording
from tests.support import INSTALLED, slowly
from tests.support.launching import running, wait_for
from tests.support.logging_arm import diary, forces, scene


@pytest.mark.process
@pytest.mark.smoke
@pytest.mark.parametrize(
    "call",
    slowly(["open", "read_position", "write_force", "close"], but=["write_force"]),
)
def test_a_call_that_hangs_is_noticed_told_and_ends_the_driver(
    tmp_path: Path, call: str
) -> None:
    declared = {
        "peak_force": 10.0,
        "hold": 0.05,
        "workspace": [[-0.1, 0.1]] * 3,
        "opening": 1.0,
        "closing": 1.0,
    }
    path = scene(tmp_path, hangs_in=call, declared=declared)
    with running(tmp_path, path, environment=INSTALLED, ready=False) as launch:
        if call == "close":
            wait_for(lambda: len(forces(tmp_path)) > 50, "forces are written")
            figures = launch.finish(signal.SIGINT, code=1)
        else:
            figures = launch.finish(code=1)
            assert figures["exit_reason"] == "driver: ended with exit code 3"
        assert figures["failures"] == ["driver: ended with exit code 3"]
        assert "[driver] hung: the device hangs: no end of" in launch.errors
        assert f"it was in {'_log'} (elsewhere_devices.py" in launch.errors
        assert figures["nodes"]["driver"]["state"] == "failed"
    hung = [
        event
        for event in Recording(tmp_path / "run.mcap").messages("/driver/event")
        if event.kind == "hung"
    ]
    assert len(hung) == 1


@pytest.mark.slow
def test_a_call_that_hangs_with_the_interpreter_s_lock_ends_the_driver_too(
    tmp_path: Path,
) -> None:
    """No thread of the process can check then."""
    path = scene(tmp_path, hangs_in="write_force", hangs_holding=True)
    with running(tmp_path, path, environment=INSTALLED, ready=False) as launch:
        figures = launch.finish(code=1)
    told = (
        r"driver: ended with exit code 1: its last resort: a call blocked all other threads for"
        r" [\d.]+ s: File .*_devices\.py"
    )
    assert re.match(told, figures["exit_reason"])
    assert figures["failures"] == [figures["exit_reason"]]


@pytest.mark.slow
def test_closing_gets_the_time_that_the_device_declares(tmp_path: Path) -> None:
    # Longer than the launcher waits for any other node before it presses on.
    declared = {
        "peak_force": 10.0,
        "hold": 0.05,
        "workspace": [[-0.1, 0.1]] * 3,
        "closing": 20.0,
    }
    with running(
        tmp_path, scene(tmp_path, closing=3.5, declared=declared), environment=INSTALLED
    ) as launch:
        wait_for(lambda: len(forces(tmp_path)) > 50, "forces are written")
        launch.finish(signal.SIGINT)
        assert "does not end" not in launch.errors
    assert diary(tmp_path)[-1][1] == "closed"


@pytest.mark.process
@pytest.mark.smoke
def test_hardware_that_declares_no_limits_does_not_start_unless_told_to(
    tmp_path: Path,
) -> None:
    path = scene(tmp_path, declared={"workspace": [[-0.1, 0.1]] * 3})
    with running(tmp_path, path, environment=INSTALLED, ready=False) as launch:
        launch.finish(code=1)
        assert "driver: the device declares no peak_force, hold" in launch.errors
        assert "safety.without: [peak_force, hold]" in launch.errors
    assert [call for _, call, _ in diary(tmp_path)] == ["close", "closed"]
    told = scene(
        tmp_path,
        run={"duration": 0.1},
        declared={},
        safety={"without": ["hold", "workspace"], "peak_force": 5.0},
    )
    with running(tmp_path, told, environment=INSTALLED, ready=False) as launch:
        launch.finish()
