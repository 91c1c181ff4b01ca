"""A cut recording is reported everywhere: its logger was killed, or the file was cut."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from messages.topics import DEVICE_STATE, status
from messages.types import Event, NodeStatus
from nodes.recording.accounts import completeness
from nodes.recording.reader import Recording
from nodes.recording.recover import recover
from nodes.recording.writer import RecordWriter, ended_beside
from tests.support.launching import running, wait_for
from tests.support.recorded import drop


@pytest.mark.slow
def test_a_killed_logger_is_in_the_summary_and_its_file_says_what_is_missing(
    tmp_path: Path,
) -> None:
    with running(tmp_path, "floor_drop", "duration:=4") as launch:
        folder = tmp_path / "recordings"
        wait_for(
            lambda: any(
                path.stat().st_size > 200_000 for path in folder.glob("*.mcap")
            ),
            "a flushed recording",
        )
        os.kill(launch.pid("logger"), signal.SIGKILL)
        told = launch.finish(code=None)
    path = tmp_path / told["recording"]
    assert any("logger: ended with SIGKILL" in failure for failure in told["failures"])
    assert ended_beside(path).is_file()
    recording = Recording(path)
    verdict = completeness(recording)
    # Every tick of the run is either recorded or told as missing.
    assert (
        recording.topics[DEVICE_STATE].last_seq + (verdict.missing_ticks or 0)
        == told["ticks"]
    )
    assert verdict.missing_ticks
    assert (
        verdict.text
        == f"cut at {recording.duration:.3f} s; {verdict.missing_ticks} ticks after it are not"
        " there"
    )
    assert "all there" not in " ".join(
        account.text for account in verdict.nodes.values()
    )
    assert verdict.text in (launch.haptic("bag", "info", str(path)).stdout)


def test_a_file_that_was_cut_later_says_where(tmp_path: Path) -> None:
    whole = tmp_path / "whole.mcap"
    with RecordWriter(whole, {"scenario": "floor_drop"}) as writer:
        for topic, message in drop(300):
            writer.write(topic, message, message.stamp + 1e-4)
    assert completeness(Recording(whole)).text == "complete, nothing lost"
    cut = tmp_path / "cut.mcap"
    data = whole.read_bytes()
    cut.write_bytes(data[: len(data) * 2 // 3])
    recording = Recording(cut)
    wanted = f"cut at {recording.duration:.3f} s; what came after is not there"
    assert 0.0 < recording.duration < 0.598
    assert completeness(recording).text == wanted
    # Completing the file does not bring back what is missing.
    completed = tmp_path / "completed.mcap"
    recover(cut, completed)
    assert completeness(Recording(completed)).text == wanted


def test_what_was_sent_before_the_logger_listened_is_not_lost(tmp_path: Path) -> None:
    path = tmp_path / "late.mcap"
    node, pid = "driver", 7

    def told(sent: int, state: str, stamp: float) -> NodeStatus:
        return NodeStatus(
            seq=0,
            stamp=stamp,
            node=node,
            kind="driver",
            state=state,
            pid=pid,
            sent=sent,
        )

    ticks = [(topic, message) for topic, message in drop(100) if topic == DEVICE_STATE]
    with RecordWriter(
        path, {"publishes": f'{{"{node}": ["{DEVICE_STATE}"]}}'}
    ) as writer:
        # An event and a status had gone before the logger subscribed.
        writer.write(status(node), told(2, "running", 0.0), 0.0)
        for topic, message in ticks:
            writer.write(topic, message, message.stamp + 1e-4)
        writer.write(
            f"/{node}/event",
            Event(seq=100, stamp=0.2, node=node, kind="x", reason="y"),
            0.2,
        )
        writer.write(status(node), told(2 + 1 + len(ticks) + 1, "finished", 0.21), 0.21)
    account = completeness(Recording(path)).nodes[node]
    assert (account.lost, account.early) == (0, 2)
    assert "2 before it was listened to" in account.text
