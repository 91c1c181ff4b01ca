"""Which processors a launch uses: kept awake by a fast loop, and left to the loop by whoever is not in it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from nodes.base import realtime
from tests.support.launching import HAPTIC, running, wait_for


def wake_latency() -> int:
    """Read what the kernel allows now: the least of all that is asked for [µs]."""
    latency = os.open(realtime.WAKE_LATENCY, os.O_RDONLY)
    try:
        return int.from_bytes(os.read(latency, 4), sys.byteorder, signed=True)
    finally:
        os.close(latency)


@pytest.mark.skipif(not os.access(realtime.WAKE_LATENCY, os.R_OK | os.W_OK), reason=f"no rights to {realtime.WAKE_LATENCY}")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_a_fast_loop_keeps_processors_awake_until_its_end_whatever_ends_it(tmp_path: Path, number: signal.Signals) -> None:
    before = wake_latency()
    with running(tmp_path, "floor_drop", "duration:=0") as launch:
        assert wake_latency() == before
    with running(tmp_path, "floor_drop_fast", "duration:=0") as launch:
        wait_for(lambda: wake_latency() == 0, "a fast loop keeps processors awake")
        launch.process.send_signal(number)
        wait_for(lambda: wake_latency() == before, "processors may sleep again")


def test_where_processors_cannot_be_kept_awake_the_reason_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(realtime, "WAKE_LATENCY", str(tmp_path / "none"))
        with realtime.awake() as refused:
            assert refused.startswith(f"{tmp_path}/none: No such file or directory; ")


@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="one processor: nobody can leave it to the loop")
def test_whoever_is_not_in_the_loop_leaves_its_processor_alone(tmp_path: Path) -> None:
    with running(tmp_path, "floor_drop", "duration:=0") as launch:
        chain = set(launch.run.nodes["coupling"].scheduling.cpus)
        for node in ("driver", "environment", "coupling"):
            assert os.sched_getaffinity(launch.pid(node)) == chain
        assert not chain & os.sched_getaffinity(launch.pid("logger"))
        if launch.run.processors:
            assert not chain & os.sched_getaffinity(launch.process.pid)
            recorder = subprocess.Popen(
                [*HAPTIC, "bag", "record", "--out", "beside.mcap"],
                cwd=tmp_path,
                env=launch.environment,
                stderr=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
            )
            wait_for(lambda: not chain & os.sched_getaffinity(recorder.pid), "the recorder leaves the chain's processor")
            recorder.send_signal(signal.SIGINT)
            assert recorder.wait(20.0) == 0


def test_a_processor_that_is_the_only_one_is_shared() -> None:
    before = os.sched_getaffinity(0)
    with realtime.off(before):
        assert os.sched_getaffinity(0) == before
    others = before - {min(before)}
    with realtime.off({min(before)}):
        assert os.sched_getaffinity(0) == (others or before)
    assert os.sched_getaffinity(0) == before
