"""Processors of a launch: kept awake by a fast loop, and avoided by everything else."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from nodes.base import realtime
from nodes.base.node import Node
from nodes.base.setup import Scheduling
from nodes.coupling.node import Coupling
from nodes.launcher import launch_file
from nodes.launcher.join import here
from nodes.launcher.wiring import wire
from nodes.recording.logger import Logger
from tests.support import slowly
from tests.support.launching import HAPTIC, running, wait_for


def wake_latency() -> int:
    """Return the wake-up latency that the kernel now allows [µs]."""
    latency = os.open(realtime.WAKE_LATENCY, os.O_RDONLY)
    try:
        return int.from_bytes(os.read(latency, 4), sys.byteorder, signed=True)
    finally:
        os.close(latency)


@pytest.mark.process
@pytest.mark.skipif(
    not os.access(realtime.WAKE_LATENCY, os.R_OK | os.W_OK),
    reason=f"no rights to {realtime.WAKE_LATENCY}",
)
@pytest.mark.parametrize(
    "number", slowly([signal.SIGINT, signal.SIGKILL], but=[signal.SIGKILL])
)
def test_a_fast_loop_keeps_processors_awake_until_its_end_whatever_ends_it(
    tmp_path: Path, number: signal.Signals
) -> None:
    before = wake_latency()
    with running(tmp_path, "floor_drop", "duration:=0") as launch:
        assert wake_latency() == before
    with running(tmp_path, "floor_drop_fast", "duration:=0") as launch:
        wait_for(lambda: wake_latency() == 0, "a fast loop keeps processors awake")
        launch.process.send_signal(number)
        wait_for(lambda: wake_latency() == before, "processors may sleep again")


def test_where_processors_cannot_be_kept_awake_the_reason_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(realtime, "WAKE_LATENCY", str(tmp_path / "none"))
        with realtime.awake() as refused:
            assert refused == f"{tmp_path}/none: No such file or directory"


@pytest.mark.process
@pytest.mark.skipif(
    len(os.sched_getaffinity(0)) < 2,
    reason="one processor: nobody can leave it to the loop",
)
def test_whoever_is_not_in_the_loop_leaves_its_processor_alone(tmp_path: Path) -> None:
    with running(tmp_path, "floor_drop", "duration:=0") as launch:
        chain = set(launch.run.nodes["coupling"].scheduling.cpus)
        for node in ("driver", "environment", "coupling"):
            assert os.sched_getaffinity(launch.pid(node)) == chain
        assert not chain & os.sched_getaffinity(launch.pid("logger"))
        urgency = os.sched_getparam(launch.pid("driver")).sched_priority
        for task in Path(f"/proc/{launch.pid('driver')}/task").iterdir():
            # One that is listed may have ended.
            with contextlib.suppress(OSError):
                if (task / "comm").read_text().strip().endswith("IO/1"):
                    assert not chain & os.sched_getaffinity(int(task.name)), (
                        "what serves listeners"
                    )
                    assert (
                        urgency == 0
                        or os.sched_getparam(int(task.name)).sched_priority < urgency
                    )
        for task in Path(f"/proc/{launch.pid('logger')}/task").iterdir():
            assert os.sched_getaffinity(int(task.name)) - chain, (
                f"{(task / 'comm').read_text()} of the logger"
            )
        if launch.run.processors:
            assert not chain & os.sched_getaffinity(launch.process.pid)
            recorder = subprocess.Popen(
                [*HAPTIC, "bag", "record", "--out", "beside.mcap"],
                cwd=tmp_path,
                env=launch.environment,
                stderr=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
            )
            wait_for(
                lambda: not chain & os.sched_getaffinity(recorder.pid),
                "the recorder leaves the chain's processor",
            )
            recorder.send_signal(signal.SIGINT)
            assert recorder.wait(20.0) == 0


BESIDE = """\
summary: A chain in a namespace, and a logger outside of any
include:
  - {launch: floor_drop, namespace: left, without: [logger]}
nodes:
  logger: {kind: logger}
"""


@pytest.mark.parametrize(
    ("processors", "chain", "rest"),
    [
        # A container: neither processor 0 nor those that only the machine has.
        ({3}, [], [3]),
        ({2, 3}, [2], [3]),
        ({2, 3, 5}, [2], [3, 5]),
    ],
)
def test_listeners_get_the_processors_that_the_chain_leaves(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    processors: set[int],
    chain: list[int],
    rest: list[int],
) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: processors)
    monkeypatch.setattr(realtime, "quietest_processor", lambda: min(processors))
    file = tmp_path / "beside.yaml"
    file.write_text(BESIDE, encoding="utf-8")
    setups = wire(launch_file.read(str(file), {}), "r", tmp_path, {})
    for name, setup in setups.items():
        cpus, aside = (rest, []) if name == "logger" else (chain, rest if chain else [])
        assert (setup.scheduling.cpus, setup.scheduling.aside) == (cpus, aside), name


def test_a_thread_that_may_not_step_aside_goes_on() -> None:
    """Started by hand with other processors than the launcher's."""
    stood: list[set[int]] = []

    def step() -> None:
        realtime.step_aside(Scheduling(aside=[1023]))
        stood.append(os.sched_getaffinity(0))

    thread = threading.Thread(target=step)
    thread.start()
    thread.join()
    assert stood == [os.sched_getaffinity(0)]


@pytest.mark.parametrize(("kind", "hop"), [(Coupling, True), (Logger, False)])
def test_on_another_machine_a_listener_leaves_the_quietest_processor_to_the_loop(
    kind: type[Node], hop: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {1, 2, 3})
    monkeypatch.setattr(realtime, "quietest_processor", lambda: 2)
    found = here(Scheduling(cpus=[7], fifo=53), kind)
    assert found == (
        Scheduling(cpus=[2], aside=[1, 3], fifo=53) if hop else Scheduling(cpus=[1, 3])
    )


def test_a_processor_that_is_the_only_one_is_shared() -> None:
    before = os.sched_getaffinity(0)
    with realtime.off(before):
        assert os.sched_getaffinity(0) == before
    others = before - {min(before)}
    with realtime.off({min(before)}):
        assert os.sched_getaffinity(0) == (others or before)
    assert os.sched_getaffinity(0) == before
