"""Topics on a ROS 2 graph and in a bag are the same, from one table; without any graph."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest

from messages import topics
from messages.codec import Decoder
from messages.types import DeviceState, Message, NodeStatus
from nodes.recording.export_ros2 import export_ros2
from nodes.recording.reader import Recording
from nodes.recording.ros2_messages import CHAIN_TOPICS, SHARED_TOPICS, RosMessages
from nodes.ros2.node import Ros2
from tests.support.one_process import recorded
from tests.support.setups import setup_of

pytest.importorskip("rosbags")


class Graph:
    """A graph that keeps what is published, with rosbags' types."""

    def __init__(self) -> None:
        from rosbags.typesys import Stores, get_typestore

        self.told: dict[str, list[Any]] = {}
        self.kinds: dict[str, str] = {}
        self.look_up = get_typestore(Stores.ROS2_HUMBLE).types.__getitem__

    def publisher(self, topic: str, name: str) -> Callable[[Any], None]:
        """Return a function that keeps a message."""
        self.kinds[topic] = name
        return self.told.setdefault(topic, []).append


def live(chain: str, *messages: tuple[str, Message]) -> Graph:
    """Return what a node publishes of the newest messages."""
    name = topics.within(chain, "/ros2").removeprefix("/")
    node, graph = Ros2(setup_of(name=name, kind="ros2", parameters={})), Graph()
    node._graph, node._make = graph, RosMessages(graph.look_up)  # type: ignore[assignment]
    node._prefix, node._publishers = topics.within(chain, "/haptic"), {}
    node._decoders |= {
        topic: Decoder(NodeStatus) for topic, one in messages if "status" in topic
    }
    packed = {topic: msgspec.msgpack.encode(message) for topic, message in messages}
    node._newest(packed)
    node._newest(packed)
    return graph


STATUS = NodeStatus(
    seq=0,
    stamp=1.0,
    node="left/driver",
    kind="sim_driver",
    state="running",
    **dict.fromkeys(("ticks", "sent", "received", "refused", "skipped", "gaps"), 3),
    pid=7,
    reason="",
    memory=1e6,
    cpu=0.5,
)


@pytest.mark.parametrize("chain", ["", "left"])
def test_a_chain_is_on_the_graph_as_in_its_bag(chain: str, tmp_path: Path) -> None:
    path = recorded(tmp_path, "floor_drop", "duration:=0.2")
    recording = Recording(path)
    newest = {topic: list(recording.messages(topic))[-1] for topic in topics.LOOP}
    graph = live(chain, *newest.items(), ("/left/driver/status", STATUS))
    wanted = {
        topics.within(chain, f"/haptic/{name}"): CHAIN_TOPICS[name]
        for name in CHAIN_TOPICS
    }
    assert graph.kinds == wanted | SHARED_TOPICS
    # Twice the same state: the law is said once, for it has not changed.
    counts = {topic: len(told) for topic, told in graph.told.items()}
    assert counts.pop("/tf") == 4  # device and proxy
    assert counts.pop(topics.within(chain, "/haptic/law")) == 1
    assert set(counts.values()) == {2}
    frames = [told.transforms[0].child_frame_id for told in graph.told["/tf"][:2]]
    begin = f"{chain}/haptic" if chain else "haptic"
    assert frames == [f"{begin}_device", f"{begin}_proxy"]
    (status,) = graph.told["/diagnostics"][0].status
    assert (status.level, status.name, status.message) == (0, "left/driver", "running")
    state = newest["/device/state"]
    assert isinstance(state, DeviceState)
    joints = graph.told[topics.within(chain, "/haptic/device/joints")][0]
    assert (joints.name, list(joints.position)) == (
        ["x", "y", "z"],
        list(state.position),
    )


def test_a_bag_has_the_topics_of_the_graph(tmp_path: Path) -> None:
    rosbag2 = pytest.importorskip("rosbags.rosbag2")
    path = recorded(
        tmp_path, "floor_swap", "first:=0.1", "second:=0.3", "duration:=0.5"
    )
    export_ros2(Recording(path), tmp_path / "bag")
    with rosbag2.Reader(tmp_path / "bag") as reader:
        kinds = {one.topic: one.msgtype for one in reader.connections}
        counts = {one.topic: one.msgcount for one in reader.connections}
    live_topics = {
        f"/haptic/{name}": kind for name, kind in CHAIN_TOPICS.items()
    } | SHARED_TOPICS
    assert kinds == {**live_topics, "/haptic/parameters": "std_msgs/msg/String"}
    # PD, PDα, multi-term: each is said when it takes over.
    assert counts["/haptic/law"] == 3
    assert counts["/tf"] == counts["/haptic/device/pose"] + counts["/haptic/proxy/pose"]
