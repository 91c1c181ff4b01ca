"""Nodes lost in mid-run: respawned, or the launch ends, as the launch file says."""

from __future__ import annotations

import contextlib
import os
import signal
from itertools import pairwise
from pathlib import Path

import pytest

from messages.transport.requests import ControlError
from nodes.recording.reader import Recording
from tests.support import slowly
from tests.support.launching import running, wait_for
from tests.support.odd_nodes import odd_nodes as odd_nodes
from tests.support.odd_nodes import scenario


@pytest.mark.process
@pytest.mark.parametrize("required", slowly([True, False], but=[True]))
def test_respawn_keeps_delay_and_maximum(
    tmp_path: Path, odd_nodes: dict[str, str], required: bool
) -> None:
    diary = tmp_path / "diary"
    crasher = {
        "kind": "crasher",
        "respawn": True,
        "respawn_delay": 0.2,
        "respawn_max": 2,
        "required": required,
        "parameters": {"after": 3, "diary": str(diary)},
    }
    with running(
        tmp_path,
        scenario(tmp_path, crasher=crasher),
        environment=odd_nodes,
        ready=False,
    ) as launch:
        if required:
            figures = launch.finish(code=1)
            assert figures["exit_reason"] == "crasher: ended with exit code 7"
        else:
            wait_for(
                lambda: (
                    "[launch] warning: crasher: ended with exit code 7\n"
                    in launch.errors
                ),
                "the last crash",
            )
            launch.wait_ticks(10)  # the others go on, but the run did not end as asked
            figures = launch.finish(signal.SIGINT, code=1)
            assert (figures["exit_reason"], figures["failures"]) == (
                "SIGINT",
                ["crasher: ended with exit code 7"],
            )
        assert launch.errors.count("starting it again in 0.2 s") == 2
    begun, ended = (list(map(float, diary.read_text().split()))[i::2] for i in (0, 1))
    assert len(begun) == len(ended) == 3
    assert all(again - end >= 0.2 for end, again in zip(ended, begun[1:], strict=False))


# The coupling: tests/sim/drill/test_drill.py.
@pytest.mark.process
@pytest.mark.smoke
@pytest.mark.parametrize("node", slowly(["environment", "driver"], but=["driver"]))
def test_the_loop_resumes_by_itself_when_a_killed_node_is_respawned(
    tmp_path: Path, node: str
) -> None:
    with running(
        tmp_path, scenario(tmp_path, loop={"respawn": True, "respawn_delay": 0.05})
    ) as launch:
        before = launch.pid(node)
        ticks = launch.wait_ticks(20)
        os.kill(before, signal.SIGKILL)

        def resumed() -> bool:
            with contextlib.suppress(ControlError):
                # First whether it is back: what was asked of the driver before that would be about
                # its predecessor.
                other = launch.call(node, "status", timeout=0.5)["pid"] != before
                progress = launch.call("driver", "progress", timeout=0.5)
                return bool(
                    other
                    and progress["safety"] == "active"
                    and progress["answered"] > ticks * (node != "driver")
                )
            return False

        wait_for(resumed, f"{node} is back and forces flow")
        figures = launch.finish(signal.SIGINT)
        assert figures["nodes"][node]["state"] == "finished"
    recording = Recording(tmp_path / "run.mcap")
    if node != "driver":
        # The driver said so on its topic, and in the summary.
        events = [
            event.reason
            for event in recording.messages("/driver/event")
            if event.kind == "safety"
        ]
        assert [reason for reason in events if reason.startswith("active → damping")]
        assert (
            figures["safety"]["reasons"] == events[-len(figures["safety"]["reasons"]) :]
        )
        assert figures["safety"]["entered"]["damping"] >= 1
    states = recording.messages("/device/state")
    # Ticks go on counting, whoever was killed.
    assert all(later.seq > earlier.seq for earlier, later in pairwise(states))


@pytest.mark.process
def test_a_required_node_that_is_killed_ends_the_launch(tmp_path: Path) -> None:
    with running(tmp_path, scenario(tmp_path)) as launch:
        os.kill(launch.pid("coupling"), signal.SIGKILL)
        figures = launch.finish(code=1)
        assert figures["exit_reason"] == "coupling: ended with SIGKILL"
        assert figures["nodes"]["driver"]["state"] == "finished"
        assert figures["safety"]["soft_stop_ticks"] >= 1


@pytest.mark.process
def test_nobody_raises_a_limit_while_it_runs(tmp_path: Path) -> None:
    with running(tmp_path, scenario(tmp_path)) as launch:
        for name, value in (
            ("safety.peak_force", 100.0),
            ("safety.watchdog", 10**6),
            ("safety.slew", 1e9),
        ):
            with pytest.raises(ControlError, match="while it runs, parameters of a"):
                launch.call("driver", "param.set", values={name: value})
        assert launch.call("driver", "param.get", name="safety.watchdog") == 10


@pytest.mark.process
def test_a_logger_that_is_not_required_may_be_killed(tmp_path: Path) -> None:
    with running(tmp_path, scenario(tmp_path, duration=1.0)) as launch:
        os.kill(launch.pid("logger"), signal.SIGKILL)
        figures = launch.finish(code=1)
        assert (figures["exit_reason"], figures["failures"]) == (
            "done",
            ["logger: ended with SIGKILL"],
        )


@pytest.mark.process
def test_a_loop_that_hears_nothing_takes_changes_and_ends_when_asked(
    tmp_path: Path,
) -> None:
    with running(tmp_path, "floor_drop", "duration:=0") as launch:
        launch.wait_ticks(10)
        os.kill(launch.pid("driver"), signal.SIGSTOP)
        # stable at 4 ticks of delay too, which a busy machine may measure
        for stiffness in (300.0, 350.0):
            receipt = launch.call(
                "coupling", "param.set", values={"laws.pd.stiffness": stiffness}
            )
            assert receipt["action"] == "set"
        assert launch.call("coupling", "param.get", name="laws.pd.stiffness") == 350.0
        for node in ("environment", "coupling"):
            os.kill(launch.pid(node), signal.SIGTERM)
        launch.finish(signal.SIGINT, code=None)
    assert "SIGKILL" not in launch.errors
