"""Supervision with real processes: however a launch ends, nothing stays behind.

That nothing is left is asserted by `running` at the end of each block.
"""

from __future__ import annotations

import contextlib
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import msgspec
import pytest
import zmq

from nodes.base.processor_wait import ProcessorWait
from nodes.launcher.ending import TIMEOUTS
from nodes.launcher.runs import alive
from nodes.recording.logger import QUIET_MS
from nodes.recording.reader import Recording
from sim.measure.free_ports import free_ports
from tests.support.launching import (
    DEADLINE,
    Running,
    haptic,
    processes_of,
    running,
    typed,
    wait_for,
)
from tests.support.odd_nodes import odd_nodes as odd_nodes
from tests.support.odd_nodes import scenario


def reapers(launch: Running) -> list[int]:
    return [
        number
        for number, line in processes_of(launch.runtime_dir).items()
        if "reaper.py" in line
    ]


def reaper(launch: Running) -> int:
    # Between fork and exec a new one does not show its command line yet.
    found = wait_for(lambda: reapers(launch), "a reaper")
    assert len(found) == 1
    return int(found[0])


# -- every end leaves nothing behind
# ----------------------------------------------------------------------------------


@pytest.mark.process
@pytest.mark.smoke("2-True-130")
@pytest.mark.parametrize(
    ("number", "to_group", "code"),
    [
        (signal.SIGINT, True, 130),
        (signal.SIGTERM, False, 143),
        # A run without an end of its own is not cut short by whoever ends it.
        (signal.SIGHUP, False, 0),
    ],
)
def test_signals_end_a_launch_in_order(
    tmp_path: Path, number: signal.Signals, to_group: bool, code: int
) -> None:
    with running(
        tmp_path, scenario(tmp_path, duration=600.0 if code else 0.0)
    ) as launch:
        if to_group:
            os.killpg(launch.process.pid, number)
        figures = launch.finish(None if to_group else number, code=code)
        assert figures["exit_reason"] == number.name
        assert {status["state"] for status in figures["nodes"].values()} == {"finished"}
        assert set(figures["nodes"]) == {"driver", "environment", "coupling", "logger"}
    recording = Recording(tmp_path / "run.mcap")
    assert recording.complete
    assert recording.topics["/device/state"].messages == figures["ticks"] + 1


@pytest.mark.process
def test_a_full_disk_at_the_end_does_not_keep_the_nodes_from_ending_in_order(
    tmp_path: Path,
) -> None:
    with running(tmp_path, scenario(tmp_path, duration=600.0)) as launch:
        # Read before it is written: /dev/full would never end.
        (launch.run_dir / "end.json").symlink_to("nowhere/end.json")
        (launch.run_dir / "environment.report.json.draft").symlink_to("/dev/full")
        typed(launch, "stop")
        figures = launch.finish(code=1)
        assert {
            name: status["state"] for name, status in figures["nodes"].items()
        } == dict.fromkeys(("driver", "coupling", "logger"), "finished")
        said, ended = figures["failures"]
        assert said == f"{launch.run_dir}: No such file or directory"
        assert ended == "environment: ended with exit code 1"
        assert "[environment] its report could not be written" in launch.errors
        assert "Traceback" not in launch.errors
    assert Recording(tmp_path / "run.mcap").complete


@pytest.mark.process
def test_an_interrupt_during_the_start_ends_it_without_a_traceback(
    tmp_path: Path,
) -> None:
    with running(tmp_path, scenario(tmp_path, duration=600.0), ready=False) as launch:
        wait_for(
            lambda: len(processes_of(launch.runtime_dir)) >= 3,
            "a node is being started",
        )
        launch.finish(signal.SIGINT, code=130)
        assert "Traceback" not in launch.errors


@pytest.mark.process
@pytest.mark.smoke("victims0")
@pytest.mark.parametrize(
    "victims", [("launcher",), ("reaper", "launcher"), ("launcher", "logger")]
)
def test_killed_launcher(tmp_path: Path, victims: tuple[str, ...]) -> None:
    with running(tmp_path, scenario(tmp_path)) as launch:
        if "reaper" in victims:
            first = reaper(launch)
            os.kill(first, signal.SIGKILL)
            # A launcher that has lost its reaper starts another.
            wait_for(lambda: not alive(first), "the first reaper ends")
            wait_for(
                lambda: "starting another" in launch.errors, "the launcher notices"
            )
            assert reaper(launch) != first
        if "logger" in victims:
            # A stopped node cannot end by itself.
            os.kill(launch.pid("logger"), signal.SIGSTOP)
        launch.process.kill()
        launch.process.wait()


@pytest.mark.process
def test_reaper_and_launcher_killed_at_once_leave_it_to_the_kernel_and_the_next_launch(
    tmp_path: Path,
) -> None:
    with running(tmp_path, scenario(tmp_path)) as launch:
        stale = launch.run_dir
        # At once: a launcher that finds its reaper gone ends the run in order, and a busy machine
        # leaves it the time to.
        launch.process.send_signal(signal.SIGSTOP)
        os.kill(reaper(launch), signal.SIGKILL)
        launch.process.kill()
        launch.process.wait()
        wait_for(
            lambda: not processes_of(launch.runtime_dir),
            "the parent-death signal ends the nodes",
        )
        assert stale.exists()
        # The next launch sweeps up what is older than a minute: here it is made to look so.
        os.utime(stale, (time.time() - 61.0, time.time() - 61.0))
        haptic(
            tmp_path,
            "launch",
            "free_space",
            "duration:=0.01",
            "--no-plot",
            environment=launch.environment,
        )
        assert not stale.exists()


@pytest.mark.process
def test_stopped_nodes_are_woken_up_to_end(tmp_path: Path) -> None:
    with running(tmp_path, scenario(tmp_path)) as launch:
        for node in ("environment", "logger"):
            os.kill(launch.pid(node), signal.SIGSTOP)
        figures = launch.finish(signal.SIGINT)
        assert {status["state"] for status in figures["nodes"].values()} == {"finished"}
        assert "does not end" not in launch.errors
    # Even the stopped logger closed its file.
    assert Recording(tmp_path / "run.mcap").complete


@pytest.mark.process
def test_what_does_not_end_is_killed_in_the_end_and_sooner_when_asked_twice(
    tmp_path: Path, odd_nodes: dict[str, str]
) -> None:
    path = scenario(tmp_path, deaf={"kind": "stubborn"})
    with running(tmp_path, path, environment=odd_nodes) as launch:
        begun = time.monotonic()
        launch.process.send_signal(signal.SIGINT)
        wait_for(
            lambda: not (launch.run_dir / "driver.pub").exists(), "the driver ends"
        )
        figures = launch.finish(signal.SIGINT, code=1)
        assert figures["failures"] == ["deaf: ended with SIGKILL"]
        # Asked once, the launcher would wait for each of the TIMEOUTS before it kills.
        patience = TIMEOUTS[signal.SIGINT] + TIMEOUTS[signal.SIGTERM]
        assert time.monotonic() - begun < patience
        assert launch.errors.index("deaf: does not end; SIGTERM") < launch.errors.index(
            "deaf: does not end; SIGKILL"
        )
        assert figures["nodes"]["driver"]["state"] == "finished"


@contextlib.contextmanager
def starved(pid: int, threads: str = "") -> Iterator[None]:
    """Leave a process at most a 400th of a processor, beside four busy ones.

    Or only its `threads` with this name.
    """
    processor = min(os.sched_getaffinity(0))
    spin = (
        f"import os\nos.sched_setaffinity(0, {{{processor}}})\n"
        "print(flush=True)\nwhile True: pass"
    )
    with contextlib.ExitStack() as stack:
        for _ in range(4):
            hog = stack.enter_context(
                subprocess.Popen([sys.executable, "-c", spin], stdout=subprocess.PIPE)
            )
            stack.callback(hog.kill)
            assert hog.stdout is not None
            # On a busy machine the process would have ended before they began.
            hog.stdout.readline()
        for task in Path(f"/proc/{pid}/task").iterdir():
            if threads in (task / "comm").read_text(encoding="utf-8"):
                os.sched_setaffinity(int(task.name), {processor})
                os.sched_setscheduler(int(task.name), os.SCHED_IDLE, os.sched_param(0))
        yield


@pytest.mark.process
def test_a_logger_that_stops_waits_for_what_its_own_transport_still_holds(
    tmp_path: Path,
) -> None:
    """Silence counted as the end, even if its I/O thread held all messages."""
    with running(tmp_path, scenario(tmp_path)) as launch:
        logger = launch.pid("logger")
        with starved(logger, "ZMQbg/IO"):
            launch.process.send_signal(signal.SIGINT)
            wait_for(
                lambda: not (launch.run_dir / "driver.pub").exists(), "the driver ends"
            )
            # Longer than any while that it may take for the end.
            time.sleep(5 * QUIET_MS / 1e3)
        figures = launch.finish()
    assert (
        Recording(tmp_path / "run.mcap").topics["/device/state"].messages
        == figures["ticks"] + 1
    )


@pytest.mark.slow
def test_what_others_keep_from_running_is_waited_for(tmp_path: Path) -> None:
    with running(tmp_path, scenario(tmp_path)) as launch:
        logger = launch.pid("logger")
        waits = {name: ProcessorWait() for name in ("logger", "reaper")}
        pids = {"logger": logger, "reaper": reaper(launch)}
        for name, wait in waits.items():
            wait.update(pids[name])
        with starved(logger):
            launch.process.send_signal(signal.SIGINT)
            # Its own clock: what the launcher would have granted it, had it not been kept from
            # running.
            wait_for(
                lambda: waits["logger"].update(logger) > TIMEOUTS[signal.SIGINT],
                "the logger waits for a processor",
            )
            assert (
                waits["reaper"].update(pids["reaper"]) < 0.5 * TIMEOUTS[signal.SIGINT]
            ), "it waits for the launcher, not for a processor"
            # The launcher comes to the logger when all others have ended.
            wait_for(
                lambda: "logger: does not get its turn" in launch.errors,
                "the launcher says so",
            )
            # It once lost most of a recording.
            assert "does not end" not in launch.errors
            assert launch.process.poll() is None
        figures = launch.finish()
        assert {status["state"] for status in figures["nodes"].values()} == {"finished"}
    recording = Recording(tmp_path / "run.mcap")
    assert recording.complete
    assert recording.topics["/device/state"].messages == figures["ticks"] + 1


@pytest.fixture
def ice() -> Iterator[Path]:
    """Return a control group whose frozen processes cannot die."""
    group = Path(f"/sys/fs/cgroup/freezer/haptic-test-{os.getpid()}")
    try:
        group.mkdir()
    except OSError as error:
        pytest.skip(f"no freezer to make a control group in: {error}")
    yield group
    (group / "freezer.state").write_text("THAWED")
    group.rmdir()


@pytest.mark.slow
def test_what_not_even_sigkill_ends_does_not_hold_up_the_end(
    tmp_path: Path, ice: Path
) -> None:
    with running(tmp_path, scenario(tmp_path)) as launch:
        (ice / "cgroup.procs").write_text(str(launch.pid("logger")))
        (ice / "freezer.state").write_text("FROZEN")
        launch.process.send_signal(signal.SIGINT)
        wait_for(
            lambda: not (launch.run_dir / "driver.pub").exists(), "the driver ends"
        )
        launch.process.send_signal(signal.SIGINT)
        # It once waited for ever.
        assert launch.process.wait(DEADLINE) == 1
        assert launch.figures["failures"][0].startswith(
            "logger: process still there 2 s after SIGKILL"
        )
        assert launch.figures["nodes"]["driver"]["state"] == "finished"
        (ice / "freezer.state").write_text("THAWED")
        wait_for(
            lambda: not (ice / "cgroup.procs").read_text(), "the killed process ends"
        )


@pytest.mark.process
@pytest.mark.smoke("signal")
@pytest.mark.parametrize("fails", ["device", "bug", "signal"])
def test_on_every_way_out_the_force_goes_down_to_zero_and_the_device_is_closed(
    tmp_path: Path, odd_nodes: dict[str, str], fails: str
) -> None:
    diary = tmp_path / "diary"
    path = scenario(
        tmp_path,
        arm={"kind": "arms", "parameters": {"diary": str(diary), "fails": fails}},
    )
    content = msgspec.json.decode(Path(path).read_bytes())
    del content["nodes"]["driver"]
    Path(path).write_bytes(msgspec.json.encode(content))
    with running(tmp_path, path, environment=odd_nodes, ready=False) as launch:
        if fails == "signal":
            wait_for(
                lambda: diary.exists() and diary.read_text().count("\n") > 100,
                "forces are written",
            )
            os.kill(launch.pid("arm"), signal.SIGTERM)
        launch.finish(code=0 if fails == "signal" else 1)
        assert (
            fails != "device"
            or "[arm] ended: the cable is out; plug it in" in launch.errors
        )
    first, *forces, last = diary.read_text().split()
    assert (first, last) == ("open", "close")
    pressed = [float(force) for force in forces]
    assert 1.0 in {round(force, 9) for force in pressed}
    # From wherever it was (a busy machine may have let it go already) it goes down step by step, to
    # zero.
    down = pressed[-10:]
    assert down[-1] == 0.0
    assert all(later <= earlier for earlier, later in pairwise(down))
    assert all(earlier - later <= 0.1 + 1e-9 for earlier, later in pairwise(down))


# -- failures at the start
# --------------------------------------------------------------------------------------------


@pytest.mark.process
def test_a_node_that_cannot_start_fails_the_launch_with_its_reason(
    tmp_path: Path, odd_nodes: dict[str, str]
) -> None:
    path = scenario(tmp_path, sensor={"kind": "broken"})
    with running(tmp_path, path, environment=odd_nodes, ready=False) as launch:
        figures = launch.finish(code=1)
        assert (
            "[sensor] cannot start: the sensor is not there; plug it in"
            in launch.errors
        )
        assert figures["exit_reason"] == "sensor: ended during start with exit code 1"
        assert figures["ticks"] == 0


@pytest.mark.process
def test_a_driver_that_a_library_ends_in_mid_run_is_not_done(
    tmp_path: Path, odd_nodes: dict[str, str]
) -> None:
    driver = {
        "kind": "arms",
        "parameters": {"diary": str(tmp_path / "diary"), "fails": "exit"},
    }
    with running(
        tmp_path, scenario(tmp_path, driver=driver), environment=odd_nodes, ready=False
    ) as launch:
        figures = launch.finish(code=1)
        assert figures["exit_reason"].startswith(
            "driver: ended with exit code 0 in mid-run"
        )


@pytest.mark.process
def test_a_stopped_reaper_does_not_hold_up_the_end(tmp_path: Path) -> None:
    with running(tmp_path, scenario(tmp_path)) as launch:
        os.kill(reaper(launch), signal.SIGSTOP)
        # It once waited for ever, deaf to signals.
        launch.finish(signal.SIGINT)


@pytest.mark.process
def test_a_process_of_its_own_is_what_strangers_listen_to_and_it_comes_back(
    tmp_path: Path,
) -> None:
    port = free_ports(1)
    path = scenario(tmp_path)
    content = msgspec.json.decode(Path(path).read_bytes())
    content["nodes"]["driver"]["open_port"] = port
    Path(path).write_bytes(msgspec.json.encode(content))
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(hard, 512), hard))
    try:
        with (
            running(tmp_path, path) as launch,
            zmq.Context() as context,
            context.socket(zmq.SUB) as stranger,
        ):
            driver, forwarder = launch.pid("driver"), launch.pid("forwarder")
            limits = Path(f"/proc/{driver}/limits").read_text()
            assert (
                next(
                    line for line in limits.splitlines() if "open files" in line
                ).split()[3:5]
                == [str(hard)] * 2
            )
            inodes = {
                os.readlink(one)
                for one in Path(f"/proc/{driver}/fd").glob("*")
                if one.exists()
            }
            tables = [Path(f"/proc/net/{name}").read_text() for name in ("tcp", "tcp6")]
            listening = [
                line.split() for table in tables for line in table.splitlines()[1:]
            ]
            place = next(
                words[9]
                for words in listening
                if words[1].endswith(f":{port:04X}") and words[3] == "0A"
            )
            assert f"socket:[{place}]" not in inodes, (
                "the driver listens to no stranger"
            )
            stranger.linger = 0
            stranger.connect(f"tcp://127.0.0.1:{port}")
            stranger.subscribe("/device/state")
            assert stranger.poll(20_000)
            os.kill(forwarder, signal.SIGKILL)
            wait_for(
                lambda: "forwarder: started again (1)" in launch.errors, "another one"
            )
            while stranger.poll(0):
                stranger.recv_multipart()
            assert stranger.poll(20_000)
            assert launch.pid("driver") == driver
            launch.finish(signal.SIGINT)
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
