"""The recorder between its subscription and the file, over real sockets."""

from __future__ import annotations

import math
import os
import time
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from messages.codec import encode
from messages.topics import FORCE, PROXY, status
from messages.transport.sockets import Publisher, Subscription
from messages.types import ZERO, Force, NodeStatus, Proxy
from nodes.launcher.runs import RunInfo
from nodes.recording.logger import Recorder, record
from nodes.recording.reader import Recording
from nodes.recording.writer import RecordWriter
from tests.support.launching import wait_for
from tests.support.setups import setup_of

if TYPE_CHECKING:
    from messages.transport.endpoints import Context


def test_an_answer_that_is_given_again_is_recorded_once(
    context: Context, place: str, tmp_path: Path
) -> None:
    """A node with one socket repeats answers to its subscribers too."""
    publisher, inbox = Publisher(context, place), Subscription(context, [place], [""])
    wait_for(publisher.listeners, "the subscription")
    forces = [
        encode(Force(seq=seq, stamp=0.002 * seq, force=(0.0, 0.0, 1.0)))
        for seq in (0, 1, 2)
    ]
    proxy = encode(
        Proxy(seq=1, stamp=0.002, position=ZERO, proxy=ZERO, normal=ZERO, distance=0.0)
    )
    with RecordWriter(tmp_path / "r.mcap", {}) as writer:
        recorder = Recorder(inbox, writer)
        for topic, payload in (
            (FORCE, forces[0]),
            (FORCE, forces[1]),
            (PROXY, proxy),
            (FORCE, forces[1]),
            (FORCE, forces[2]),
        ):
            publisher.send(topic.encode(), payload)
        wait_for(lambda: recorder.take(50) and recorder.recorded == 4, "all of them")
        assert not recorder.take(50)
    inbox.close()
    publisher.close()
    recording = Recording(tmp_path / "r.mcap")
    assert [force.seq for force in recording.messages(FORCE)] == [0, 1, 2]
    assert (recording.topics[FORCE].back, recording.topics[PROXY].messages) == (0, 1)


def test_a_message_of_one_node_that_came_late_leaves_none_of_another_behind(
    context: Context, place: str, tmp_path: Path
) -> None:
    """A stopped, delayed logger records of each node what was sent before."""
    busy, quiet = (
        Publisher(context, f"{place}busy"),
        Publisher(context, f"{place}quiet"),
    )
    inbox = Subscription(context, [f"{place}busy", f"{place}quiet"], [""], 10_000)
    wait_for(lambda: busy.listeners() and quiet.listeners(), "the subscriptions")
    for seq in range(500):
        busy.send(FORCE.encode(), encode(Force(seq=seq, stamp=0.002 * seq, force=ZERO)))
    told = NodeStatus(
        seq=500, stamp=99.0, node="quiet", kind="logger", state="running", pid=1
    )
    quiet.send(status("quiet").encode(), encode(told))
    with RecordWriter(tmp_path / "r.mcap", {}) as writer:
        Recorder(inbox, writer).drain(end=50.0)
    for socket in (inbox, busy, quiet):
        socket.close()
    recording = Recording(tmp_path / "r.mcap")
    assert [force.seq for force in recording.messages(FORCE)] == list(range(500))


@pytest.mark.parametrize("pace", ["realtime", "lockstep"])
def test_who_ends_a_recorder_gets_what_had_come_by_then(
    context: Context, place: str, tmp_path: Path, pace: str
) -> None:
    publisher = Publisher(context, place)
    manifest = {"pace": pace}
    run = RunInfo(
        run="r",
        scenario="s",
        launcher=os.getpid(),
        nodes={"coupling": setup_of(publish=place)},
        manifest=manifest,
    )

    def ended() -> bool:
        # Before the recorder takes anything it is ended, and all this waits.
        wait_for(publisher.listeners, "the subscription")
        for seq in range(500):
            publisher.send(
                FORCE.encode(),
                encode(Force(seq=seq, stamp=time.monotonic(), force=ZERO)),
            )
        return True

    path = tmp_path / "r.mcap"
    assert record(run, str(path), [], ended) == 500
    publisher.close()
    assert Recording(path).topics[FORCE].messages == 500


def test_the_time_of_a_recording_begins_with_its_first_message(
    context: Context, place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without an end it goes on until it is ended; with one of 0 s, one message ends it."""
    monkeypatch.setattr("nodes.recording.logger.CONNECTING", math.inf)
    publisher = Publisher(context, place)
    run = RunInfo(
        run="r",
        scenario="s",
        launcher=os.getpid(),
        nodes={"coupling": setup_of(publish=place)},
        manifest={"pace": "realtime"},
    )
    calls = 0

    def ended(last: int, sent_from: int) -> bool:
        nonlocal calls
        calls += 1
        if calls >= sent_from:
            wait_for(publisher.listeners, "the subscription")
            force = Force(seq=calls, stamp=time.monotonic(), force=ZERO)
            publisher.send(FORCE.encode(), encode(force))
        return calls >= last

    endless, short = tmp_path / "endless.mcap", tmp_path / "short.mcap"
    assert record(run, str(endless), [], lambda: ended(5, 1)) == calls == 5
    calls = 0
    assert record(run, str(short), [], lambda: ended(50, 3), duration=0.0) >= 1
    assert 3 <= calls < 50
    publisher.close()


def test_what_follows_no_protocol_is_counted_one_by_one(
    context: Context, place: str, tmp_path: Path
) -> None:
    """A topic that nobody knows, and a payload that is no message of its topic."""
    publisher, inbox = Publisher(context, place), Subscription(context, [place], [""])
    wait_for(publisher.listeners, "the subscription")
    force = encode(Force(seq=0, stamp=0.0, force=ZERO))
    with RecordWriter(tmp_path / "r.mcap", {}) as writer:
        recorder = Recorder(inbox, writer)
        for topic, payload in (
            ("/nobody/knows", force),
            (FORCE, b"no message"),
            (FORCE, force),
        ):
            publisher.send(topic.encode(), payload)
        wait_for(lambda: recorder.take(50) and recorder.recorded == 1, "the message")
    assert recorder.refused == 2
    inbox.close()
    publisher.close()
