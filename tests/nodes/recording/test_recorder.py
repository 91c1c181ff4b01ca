"""The recorder between its subscription and the file, over real sockets."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from messages.codec import encode
from messages.topics import FORCE, PROXY
from messages.transport.sockets import Publisher, Subscription
from messages.types import ZERO, Force, Proxy
from nodes.recording.logger import Recorder
from nodes.recording.reader import Recording
from nodes.recording.writer import RecordWriter
from tests.support.launching import wait_for

if TYPE_CHECKING:
    from messages.transport.endpoints import Context


def test_an_answer_that_is_given_again_is_recorded_once(context: Context, place: str, tmp_path: Path) -> None:
    """A node with one socket for all, on another machine, answers its listeners too when the driver asks again."""
    publisher, inbox = Publisher(context, place), Subscription(context, [place], [""])
    wait_for(publisher.listeners, "the subscription")
    forces = [encode(Force(seq=seq, stamp=0.002 * seq, force=(0.0, 0.0, 1.0))) for seq in (0, 1, 2)]
    proxy = encode(Proxy(seq=1, stamp=0.002, position=ZERO, proxy=ZERO, normal=ZERO, distance=0.0))
    with RecordWriter(tmp_path / "r.mcap", {}) as writer:
        recorder = Recorder(inbox, writer)
        for topic, payload in ((FORCE, forces[0]), (FORCE, forces[1]), (PROXY, proxy), (FORCE, forces[1]), (FORCE, forces[2])):
            publisher.send(topic.encode(), payload)
        wait_for(lambda: recorder.take(50) and recorder.recorded == 4, "all of them")
        assert not recorder.take(50)
    inbox.close()
    publisher.close()
    recording = Recording(tmp_path / "r.mcap")
    assert [force.seq for force in recording.messages(FORCE)] == [0, 1, 2]
    assert (recording.topics[FORCE].back, recording.topics[PROXY].messages) == (0, 1)
