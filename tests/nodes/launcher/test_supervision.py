"""Supervision with real processes: whatever ends a launch, in whatever order, no process and no file stays behind.

That nothing is left is asserted by `running` at the end of each block.
"""

from __future__ import annotations

import contextlib
import os
import resource
import signal
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import msgspec
import pytest
import zmq

from messages.transport.requests import ControlError
from nodes.launcher.runs import alive
from nodes.launcher.supervisor import INT_TIMEOUT
from nodes.recording.reader import Recording
from tests.support.launching import DEADLINE, Running, haptic, processes_of, running, wait_for
from tests.support.ports import free_ports

PACKAGE = '''
import os, signal, time
from typing import ClassVar
import msgspec
from nodes.base.node import IDLE_MS, Node
from nodes.driver.device import DeviceLimits
from nodes.driver.node import Driver
from nodes.driver.parameters import DriverParameters

class Parameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    after: int = 0
    diary: str = ""

class Crasher(Node):
    """Ends with exit code 7 after some states."""
    Parameters = Parameters
    listens_to = ("/device/state",)
    def loop(self):
        self.state = "running"
        with open(self.store.current.diary, "a") as diary:
            diary.write(f"{time.monotonic()}\\n")
        for _ in range(self.store.current.after):
            while self.inbox.receive(IDLE_MS) is None and not self.stopping:
                pass
        if not self.stopping:
            with open(self.store.current.diary, "a") as diary:
                diary.write(f"{time.monotonic()}\\n")
                diary.flush()
                os._exit(7)

class Stubborn(Node):
    """Hears no signal."""
    listens_to = ("/device/state",)
    def loop(self):
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM, signal.SIGHUP})
        self.state = "running"
        while True:
            time.sleep(1.0)

class Arm:
    """Held 1 mm inside the floor; writes down every force, and fails after 100 ticks in the way it is told to."""
    limits = DeviceLimits(peak_force=10.0, hold=0.1, workspace=((-0.1, 0.1),) * 3)
    def __init__(self, path, fails):
        self.diary, self.fails, self.ticks = open(path, "a"), fails, 0
    def open(self):
        self.write("open")
    def write(self, text):
        self.diary.write(f"{text}\\n")
        self.diary.flush()
    def read_position(self, seq):
        self.ticks += 1
        if self.ticks > 100 and self.fails == "device":
            raise OSError("the cable is out; plug it in")
        if self.ticks > 100 and self.fails == "exit":
            os._exit(0)
        if self.ticks > 100 and self.fails == "bug":
            return 1 / 0
        return (0.0, 0.0, -0.001)
    def write_force(self, force, seq, offset):
        self.write(force[2])
    def close(self):
        self.write("close")

class ArmParameters(DriverParameters, frozen=True, forbid_unknown_fields=True, kw_only=True):
    diary: str
    fails: str

class Arms(Driver):
    """A driver of such an arm."""
    Parameters = ArmParameters
    def make_device(self):
        return Arm(self.store.current.diary, self.store.current.fails)

class Broken(Node):
    """Cannot be configured."""
    listens_to = ("/device/state",)
    def configure(self):
        raise ValueError("the sensor is not there; plug it in")
'''

DIST_INFO = {
    "METADATA": "Metadata-Version: 2.1\nName: odd-nodes\nVersion: 0\n",
    "entry_points.txt": "[haptic.nodes]\n"
    + "".join(f"{kind.lower()} = odd_nodes:{kind}\n" for kind in ("Crasher", "Stubborn", "Broken", "Arms")),
}


@pytest.fixture
def odd_nodes(tmp_path: Path) -> dict[str, str]:
    """Install nodes that behave badly by PYTHONPATH; give the variables for a launch."""
    folder = tmp_path / "site"
    info = folder / "odd_nodes-0.dist-info"
    info.mkdir(parents=True)
    (folder / "odd_nodes.py").write_text(PACKAGE)
    for name, text in DIST_INFO.items():
        (info / name).write_text(text)
    return {"PYTHONPATH": f"{folder}:{os.environ.get('PYTHONPATH', '')}"}


def scenario(folder: Path, duration: float = 0.0, loop: dict[str, Any] | None = None, **more: Any) -> str:
    """Write a launch file: a mass in free fall onto a floor, a logger, and more nodes; `loop` is added to the chain."""
    chain = loop or {}
    content = {
        "summary": "for a test",
        "run": {"duration": duration},
        "nodes": {
            "driver": {
                "kind": "sim_driver",
                "parameters": {"device": {"mass": 0.1, "damping": 1.0, "gravity": 9.81, "position": 0.001}},
                **chain,
            },
            "environment": {"kind": "environment", "parameters": {"surface": {"kind": "plane", "axis": "z"}}, **chain},
            "coupling": {
                "kind": "coupling",
                "parameters": {"law": "pd", "laws": {"pd": {"kind": "pd", "stiffness": 1000.0, "damping": 3.0}}},
                **chain,
            },
            "logger": {"kind": "logger", "required": False, "parameters": {"path": "run.mcap"}},
            **more,
        },
    }
    path = folder / "odd.yaml"
    path.write_bytes(msgspec.json.encode(content))  # JSON is YAML
    return str(path)


def reapers(launch: Running) -> list[int]:
    return [number for number, line in processes_of(launch.runtime_dir).items() if "reaper.py" in line]


def reaper(launch: Running) -> int:
    # Between fork and exec a new one does not show its command line yet.
    found = wait_for(lambda: reapers(launch), "a reaper")
    assert len(found) == 1
    return int(found[0])


# -- every end leaves nothing behind ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("number", "to_group", "code"),
    [
        (signal.SIGINT, True, 130),
        (signal.SIGTERM, False, 143),
    ],
)
def test_signals_end_a_launch_in_order(tmp_path: Path, number: signal.Signals, to_group: bool, code: int) -> None:
    with running(tmp_path, scenario(tmp_path, duration=600.0)) as launch:
        if to_group:
            os.killpg(launch.process.pid, number)
        figures = launch.finish(None if to_group else number, code=code)
        assert figures["exit_reason"] == number.name
        assert {status["state"] for status in figures["nodes"].values()} == {"finished"}
        assert set(figures["nodes"]) == {"driver", "environment", "coupling", "logger"}
    recording = Recording(tmp_path / "run.mcap")
    assert recording.complete
    assert recording.topics["/device/state"].messages == figures["ticks"] + 1


def test_an_interrupt_during_the_start_ends_it_without_a_traceback(tmp_path: Path) -> None:
    with running(tmp_path, scenario(tmp_path, duration=600.0), ready=False) as launch:
        wait_for(lambda: len(processes_of(launch.runtime_dir)) >= 3, "a node is being started")
        launch.finish(signal.SIGINT, code=130)
        assert "Traceback" not in launch.errors


@pytest.mark.parametrize("victims", [("launcher",), ("reaper", "launcher"), ("launcher", "logger")])
def test_killed_launcher(tmp_path: Path, victims: tuple[str, ...]) -> None:
    with running(tmp_path, scenario(tmp_path)) as launch:
        if "reaper" in victims:
            first = reaper(launch)
            os.kill(first, signal.SIGKILL)
            # A launcher that has lost its reaper starts another.
            wait_for(lambda: not alive(first), "the first reaper ends")
            wait_for(lambda: "starting another" in launch.errors, "the launcher notices")
            assert reaper(launch) != first
        if "logger" in victims:
            # A stopped node cannot end by itself.
            os.kill(launch.pid("logger"), signal.SIGSTOP)
        launch.process.kill()
        launch.process.wait()


def test_reaper_and_launcher_killed_at_once_leave_it_to_the_kernel_and_the_next_launch(tmp_path: Path) -> None:
    with running(tmp_path, scenario(tmp_path)) as launch:
        stale = launch.run_dir
        os.kill(reaper(launch), signal.SIGKILL)
        launch.process.kill()
        launch.process.wait()
        wait_for(lambda: not processes_of(launch.runtime_dir), "the parent-death signal ends the nodes")
        assert stale.exists()
        # The next launch sweeps up what is older than a minute: here it is made to look so.
        os.utime(stale, (time.time() - 61.0, time.time() - 61.0))
        haptic(tmp_path, "launch", "free_space", "duration:=0.01", "--no-plot", environment=launch.environment)
        assert not stale.exists()


def test_stopped_nodes_are_woken_up_to_end(tmp_path: Path) -> None:
    with running(tmp_path, scenario(tmp_path)) as launch:
        for node in ("environment", "logger"):
            os.kill(launch.pid(node), signal.SIGSTOP)
        figures = launch.finish(signal.SIGINT)
        assert {status["state"] for status in figures["nodes"].values()} == {"finished"}
        assert "does not end" not in launch.errors
    # Even the stopped logger closed its file.
    assert Recording(tmp_path / "run.mcap").complete


def test_what_does_not_end_is_killed_in_the_end_and_sooner_when_asked_twice(
    tmp_path: Path, odd_nodes: dict[str, str]
) -> None:
    path = scenario(tmp_path, deaf={"kind": "stubborn"})
    with running(tmp_path, path, environment=odd_nodes) as launch:
        begun = time.monotonic()
        launch.process.send_signal(signal.SIGINT)
        wait_for(lambda: not (launch.run_dir / "driver.pub").exists(), "the driver ends")
        figures = launch.finish(signal.SIGINT, code=1)
        assert figures["failures"] == ["deaf: ended with SIGKILL"]
        # Asked once, the launcher would wait INT_TIMEOUT before it presses at all, and TERM_TIMEOUT before it kills.
        assert time.monotonic() - begun < INT_TIMEOUT
        assert launch.errors.index("deaf: does not end; SIGTERM") < launch.errors.index("deaf: does not end; SIGKILL")
        assert figures["nodes"]["driver"]["state"] == "finished"


@pytest.fixture
def ice() -> Iterator[Path]:
    """Make a control group whose processes the kernel does not let die when they are frozen."""
    group = Path(f"/sys/fs/cgroup/freezer/haptic-test-{os.getpid()}")
    try:
        group.mkdir()
    except OSError as error:
        pytest.skip(f"no freezer to make a control group in: {error}")
    yield group
    (group / "freezer.state").write_text("THAWED")
    group.rmdir()


def test_what_not_even_sigkill_ends_does_not_hold_up_the_end(tmp_path: Path, ice: Path) -> None:
    with running(tmp_path, scenario(tmp_path)) as launch:
        (ice / "cgroup.procs").write_text(str(launch.pid("logger")))
        (ice / "freezer.state").write_text("FROZEN")
        launch.process.send_signal(signal.SIGINT)
        wait_for(lambda: not (launch.run_dir / "driver.pub").exists(), "the driver ends")
        launch.process.send_signal(signal.SIGINT)
        # It once waited for ever.
        assert launch.process.wait(DEADLINE) == 1
        assert launch.figures["failures"][0].startswith("logger: process still there 2 s after SIGKILL")
        assert launch.figures["nodes"]["driver"]["state"] == "finished"
        (ice / "freezer.state").write_text("THAWED")
        wait_for(lambda: not (ice / "cgroup.procs").read_text(), "the killed process ends")


@pytest.mark.parametrize("fails", ["device", "bug", "signal"])
def test_on_every_way_out_the_force_goes_down_to_zero_and_the_device_is_closed(
    tmp_path: Path, odd_nodes: dict[str, str], fails: str
) -> None:
    diary = tmp_path / "diary"
    path = scenario(tmp_path, arm={"kind": "arms", "parameters": {"diary": str(diary), "fails": fails}})
    content = msgspec.json.decode(Path(path).read_bytes())
    del content["nodes"]["driver"]
    Path(path).write_bytes(msgspec.json.encode(content))
    with running(tmp_path, path, environment=odd_nodes, ready=False) as launch:
        if fails == "signal":
            wait_for(lambda: diary.exists() and diary.read_text().count("\n") > 100, "forces are written")
            os.kill(launch.pid("arm"), signal.SIGTERM)
        launch.finish(code=0 if fails == "signal" else 1)
        assert fails != "device" or "[arm] ended: the cable is out; plug it in" in launch.errors
    first, *forces, last = diary.read_text().split()
    assert (first, last) == ("open", "close")
    pressed = [float(force) for force in forces]
    assert 1.0 in {round(force, 9) for force in pressed}
    # From wherever it was (a busy machine may have let it go already) it goes down step by step, to zero.
    down = pressed[-10:]
    assert down[-1] == 0.0
    assert all(later <= earlier for earlier, later in pairwise(down))
    assert all(earlier - later <= 0.1 + 1e-9 for earlier, later in pairwise(down))


# -- failures at the start --------------------------------------------------------------------------------------------


def test_a_node_that_cannot_start_fails_the_launch_with_its_reason(tmp_path: Path, odd_nodes: dict[str, str]) -> None:
    path = scenario(tmp_path, sensor={"kind": "broken"})
    with running(tmp_path, path, environment=odd_nodes, ready=False) as launch:
        figures = launch.finish(code=1)
        assert "[sensor] cannot start: the sensor is not there; plug it in" in launch.errors
        assert figures["exit_reason"] == "sensor: ended during start with exit code 1"
        assert figures["ticks"] == 0


def test_a_driver_that_a_library_ends_in_mid_run_is_not_done(tmp_path: Path, odd_nodes: dict[str, str]) -> None:
    driver = {"kind": "arms", "parameters": {"diary": str(tmp_path / "diary"), "fails": "exit"}}
    with running(tmp_path, scenario(tmp_path, driver=driver), environment=odd_nodes, ready=False) as launch:
        figures = launch.finish(code=1)
        assert figures["exit_reason"].startswith("driver: ended with exit code 0 in mid-run")


def test_a_stopped_reaper_does_not_hold_up_the_end(tmp_path: Path) -> None:
    with running(tmp_path, scenario(tmp_path)) as launch:
        os.kill(reaper(launch), signal.SIGSTOP)
        # It once waited for ever, deaf to signals.
        launch.finish(signal.SIGINT)


def test_a_process_of_its_own_is_what_strangers_listen_to_and_it_comes_back(tmp_path: Path) -> None:
    port = free_ports(1)
    path = scenario(tmp_path)
    content = msgspec.json.decode(Path(path).read_bytes())
    content["nodes"]["driver"]["open_port"] = port
    Path(path).write_bytes(msgspec.json.encode(content))
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(hard, 512), hard))
    try:
        with running(tmp_path, path) as launch, zmq.Context() as context, context.socket(zmq.SUB) as stranger:
            driver, forwarder = launch.pid("driver"), launch.pid("forwarder")
            limits = Path(f"/proc/{driver}/limits").read_text()
            assert next(line for line in limits.splitlines() if "open files" in line).split()[3:5] == [str(hard)] * 2
            inodes = {os.readlink(one) for one in Path(f"/proc/{driver}/fd").glob("*") if one.exists()}
            tables = [Path(f"/proc/net/{name}").read_text() for name in ("tcp", "tcp6")]
            listening = [line.split() for table in tables for line in table.splitlines()[1:]]
            place = next(words[9] for words in listening if words[1].endswith(f":{port:04X}") and words[3] == "0A")
            assert f"socket:[{place}]" not in inodes, "the driver listens to no stranger"
            stranger.linger = 0
            stranger.connect(f"tcp://127.0.0.1:{port}")
            stranger.subscribe("/device/state")
            assert stranger.poll(20_000)
            os.kill(forwarder, signal.SIGKILL)
            wait_for(lambda: "forwarder: started again (1)" in launch.errors, "another one")
            while stranger.poll(0):
                stranger.recv_multipart()
            assert stranger.poll(20_000)
            assert launch.pid("driver") == driver
            launch.finish(signal.SIGINT)
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


# -- respawn ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("required", [True, False])
def test_respawn_keeps_delay_and_maximum(tmp_path: Path, odd_nodes: dict[str, str], required: bool) -> None:
    diary = tmp_path / "diary"
    crasher = {
        "kind": "crasher",
        "respawn": True,
        "respawn_delay": 0.2,
        "respawn_max": 2,
        "required": required,
        "parameters": {"after": 3, "diary": str(diary)},
    }
    with running(tmp_path, scenario(tmp_path, crasher=crasher), environment=odd_nodes, ready=False) as launch:
        if required:
            figures = launch.finish(code=1)
            assert figures["exit_reason"] == "crasher: ended with exit code 7"
        else:
            wait_for(lambda: "[launch] crasher: ended with exit code 7\n" in launch.errors, "the last crash")
            launch.wait_ticks(10)  # the others go on, but the run did not end as asked
            figures = launch.finish(signal.SIGINT, code=1)
            assert (figures["exit_reason"], figures["failures"]) == ("SIGINT", ["crasher: ended with exit code 7"])
        assert launch.errors.count("starting it again in 0.2 s") == 2
    begun, ended = (list(map(float, diary.read_text().split()))[i::2] for i in (0, 1))
    assert len(begun) == len(ended) == 3
    assert all(again - end >= 0.2 for end, again in zip(ended, begun[1:], strict=False))


@pytest.mark.parametrize("node", ["environment", "driver"])  # the coupling: tests/sim/drill/test_drill.py
def test_the_loop_resumes_by_itself_when_a_killed_node_is_respawned(tmp_path: Path, node: str) -> None:
    with running(tmp_path, scenario(tmp_path, loop={"respawn": True, "respawn_delay": 0.05})) as launch:
        before = launch.pid(node)
        ticks = launch.wait_ticks(20)
        os.kill(before, signal.SIGKILL)

        def resumed() -> bool:
            with contextlib.suppress(ControlError):
                # First whether it is back: what was asked of the driver before that would be about its predecessor.
                other = launch.call(node, "status", timeout=0.5)["pid"] != before
                progress = launch.call("driver", "progress", timeout=0.5)
                return bool(
                    other and progress["safety"] == "active" and progress["answered"] > ticks * (node != "driver")
                )
            return False

        wait_for(resumed, f"{node} is back and forces flow")
        figures = launch.finish(signal.SIGINT)
        assert figures["nodes"][node]["state"] == "finished"
    recording = Recording(tmp_path / "run.mcap")
    if node != "driver":
        # The driver said so on its topic, and in the summary.
        events = [event.reason for event in recording.messages("/driver/event") if event.kind == "safety"]
        assert [reason for reason in events if reason.startswith("active → damping")]
        assert figures["safety"]["reasons"] == events[-len(figures["safety"]["reasons"]) :]
        assert figures["safety"]["entered"]["damping"] >= 1
    states = recording.messages("/device/state")
    # Ticks go on counting, whoever was killed.
    assert all(later.seq > earlier.seq for earlier, later in pairwise(states))


def test_a_required_node_that_is_killed_ends_the_launch(tmp_path: Path) -> None:
    with running(tmp_path, scenario(tmp_path)) as launch:
        os.kill(launch.pid("coupling"), signal.SIGKILL)
        figures = launch.finish(code=1)
        assert figures["exit_reason"] == "coupling: ended with SIGKILL"
        assert figures["nodes"]["driver"]["state"] == "finished"
        assert figures["safety"]["soft_stop_ticks"] >= 1


def test_nobody_raises_a_limit_while_it_runs(tmp_path: Path) -> None:
    with running(tmp_path, scenario(tmp_path)) as launch:
        for name, value in (("safety.peak_force", 100.0), ("safety.watchdog", 10**6), ("safety.slew", 1e9)):
            with pytest.raises(ControlError, match="fixed while it runs"):
                launch.call("driver", "param.set", values={name: value})
        assert launch.call("driver", "param.get", name="safety.watchdog") == 10


def test_a_logger_that_is_not_required_may_be_killed(tmp_path: Path) -> None:
    with running(tmp_path, scenario(tmp_path, duration=1.0)) as launch:
        os.kill(launch.pid("logger"), signal.SIGKILL)
        figures = launch.finish(code=1)
        assert (figures["exit_reason"], figures["failures"]) == ("done", ["logger: ended with SIGKILL"])


def test_a_loop_that_hears_nothing_takes_changes_and_ends_when_asked(tmp_path: Path) -> None:
    with running(tmp_path, "floor_drop", "duration:=0") as launch:
        launch.wait_ticks(10)
        os.kill(launch.pid("driver"), signal.SIGSTOP)
        for stiffness in (900.0, 1100.0):
            receipt = launch.call("coupling", "param.set", values={"laws.pd.stiffness": stiffness})
            assert receipt["action"] == "set"
        assert launch.call("coupling", "param.get", name="laws.pd.stiffness") == 1100.0
        for node in ("environment", "coupling"):
            os.kill(launch.pid(node), signal.SIGTERM)
        launch.finish(signal.SIGINT, code=None)
    assert "SIGKILL" not in launch.errors
