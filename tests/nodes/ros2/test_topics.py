"""Topics on a ROS 2 graph and in a bag are the same, from one table; without any graph."""

from __future__ import annotations

import json
import math
from collections import defaultdict
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import nodes.ros2.node as bridge
from messages import topics
from messages.codec import Decoder
from messages.types import DeviceState, NodeStatus
from nodes.base.events import Events
from nodes.environment.shapes.scene import rotation
from nodes.recording.export_ros2 import export_ros2
from nodes.recording.reader import Recording
from nodes.recording.ros2_defaults import Constructors
from nodes.recording.ros2_messages import RosMessages, ros2_topics
from nodes.recording.ros2_shapes import CUBE, drawn_shapes, from_z_to, turned_by
from nodes.recording.writer import RecordWriter
from nodes.ros2.chain_control import ChainControl
from nodes.ros2.node import Ros2
from tests.support.one_process import recorded
from tests.support.setups import setup_of

pytest.importorskip("rosbags")

DEPTH = 10


class Graph:
    """A graph that keeps what is published, in the layout of ROS, with rosbags' types."""

    def __init__(self) -> None:
        from rosbags.typesys import Stores, get_typestore

        self.store = get_typestore(Stores.ROS2_HUMBLE)
        self.told: dict[str, list[bytes]] = defaultdict(list)
        self.kinds: dict[str, tuple[str, int]] = {}
        self.look_up = Constructors(
            self.store,
            self.store.types.__getitem__,
            lambda name: np.empty(0, np.dtype(name)),
        ).look_up

    def publisher(self, topic: str, name: str, latched: int) -> Callable[[Any], None]:
        """Return a function that keeps a message."""
        self.kinds[topic] = name, latched
        return lambda message: self.told[topic].append(
            bytes(self.store.serialize_cdr(message, name))
        )

    def read(self, topic: str) -> list[Any]:
        """Return the messages of a topic."""
        kind = self.kinds[topic][0]
        return [self.store.deserialize_cdr(raw, kind) for raw in self.told[topic]]

    def serve(self, change: object) -> bool:
        """Serve nothing."""
        del change
        return False


def node_on(
    graph: Graph, chain: str, manifest: Mapping[str, str], pace: str, nodes: Any
) -> Ros2:
    """Return a bridge of a chain, whose nodes have these parameters, on a graph."""
    node = Ros2(
        setup_of(
            name=topics.within(chain, "/ros2").removeprefix("/"),
            kind="ros2",
            parameters={},
            manifest=dict(manifest),
            pace=pace,
        )
    )
    node._graph = graph  # type: ignore[assignment]
    node._make = RosMessages(
        graph.look_up, sequence=lambda values: np.array(values, float)
    )
    node._prefix = topics.within(chain, "/haptic")
    node._open_publishers()
    node._control = ChainControl(
        graph,  # type: ignore[arg-type]
        None,  # type: ignore[arg-type]
        {name: name for name in nodes},
        nodes.__getitem__,
    )
    node._decoders |= {
        topics.status(name): Decoder(NodeStatus) for name in ("driver", "left/driver")
    }
    return node


STATUS = NodeStatus(
    seq=0,
    stamp=0.01,
    node="left/driver",
    kind="sim_driver",
    state="running",
    **dict.fromkeys(("ticks", "sent", "received", "refused", "skipped", "gaps"), 3),
    pid=7,
    reason="",
    memory=1e6,
    cpu=0.5,
)


def in_real_time(path: Path, chain: str, begin: float) -> Path:
    """Return a recording in real time, of a chain, with the messages of one in lockstep."""
    recording = Recording(path)
    manifest = {
        **recording.manifest,
        "pace": "realtime",
        "wall_minus_monotonic_s": "1764000000.123456789",
    }
    real = path.with_name("real.mcap")
    parameters = recording.metadata["parameters"]
    with RecordWriter(real, manifest, parameters=parameters) as writer:
        for entry in recording.entries():
            moved = msgspec.structs.replace(
                entry.message, stamp=entry.message.stamp + begin
            )
            writer.write(topics.within(chain, entry.topic), moved, moved.stamp)
        writer.write(
            topics.status(STATUS.node),
            msgspec.structs.replace(STATUS, stamp=begin + 1.0),
            begin + 1.0,
        )
    return real


def read_bag(folder: Path) -> tuple[dict[str, Any], dict[str, list[bytes]]]:
    """Return the connections and the serialised messages of a bag, by topic."""
    from rosbags.rosbag2 import Reader

    found: dict[str, list[bytes]] = defaultdict(list)
    with Reader(folder) as reader:
        for line, _, raw in reader.messages():
            found[line.topic].append(bytes(raw))
        return {one.topic: one for one in reader.connections}, found


@pytest.mark.parametrize(("chain", "pace"), [("", "lockstep"), ("left", "realtime")])
def test_a_bag_has_the_very_bytes_that_the_graph_hears(
    chain: str, pace: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # What stands is said once: it is repeated for subscribers that do not latch.
    monkeypatch.setattr(bridge, "SELDOM", 1e9)
    path = recorded(
        tmp_path, "floor_swap", "first:=0.02", "second:=0.06", "duration:=0.1"
    )
    if pace == "realtime":
        # A monotonic clock of days, as a machine's.
        path = in_real_time(path, chain, begin=432_001.234567)
    recording, graph = Recording(path), Graph()
    nodes = {
        name: json.loads(text)
        for name, text in recording.metadata["parameters"].items()
    }
    node = node_on(graph, chain, recording.manifest, pace, nodes)
    assert node._control is not None
    # One message at a time: on a graph of 500 Hz nothing is left out.
    for number, entry in enumerate(recording.entries()):
        inside = topics.split(entry.topic)[1]
        name = inside if inside in topics.LOOP else entry.topic
        if name in node._decoders:
            node._newest({name: msgspec.msgpack.encode(entry.message)})
        if number == 0:
            node._read_parameters(node._control)
            node._newest({})
    export_ros2(recording, tmp_path / "bag")
    offered, found = read_bag(tmp_path / "bag")
    wanted = ros2_topics(chain, simulated=pace == "lockstep")
    assert {topic: one.msgtype for topic, one in offered.items()} == {
        topic: kind for topic, (kind, _) in wanted.items()
    }
    for topic, (_, latched) in wanted.items():
        (qos,) = offered[topic].ext.offered_qos_profiles
        assert qos.durability.name == ("TRANSIENT_LOCAL" if latched else "VOLATILE")
        assert qos.depth == (latched or DEPTH)
        assert qos.reliability.name == "RELIABLE"
    prefix = topics.within(chain, "/haptic")
    # The text about the run has more in a file, which knows its own name.
    texts = found.pop(f"{prefix}/parameters"), graph.told.pop(f"{prefix}/parameters")
    in_bag, live = (
        [json.loads(raw[8:].rstrip(b"\0")) for raw in part] for part in texts
    )
    assert [one["parameters"] for one in in_bag] == [nodes]
    assert [one["parameters"] for one in live] == [nodes]
    assert live[0]["manifest"] == in_bag[0]["manifest"]
    assert dict(graph.told) == dict(found)
    assert graph.kinds == wanted
    if pace == "realtime":
        (status,) = graph.read("/diagnostics")[0].status
        told = status.level, status.name, status.message
        assert told == (0, "left/driver", "running")
    # PD, PDα, multi-term: each is said when it takes over.
    assert len(found[f"{prefix}/law"]) == 3
    begin = f"{chain}/haptic" if chain else "haptic"
    frames = {one.transforms[0].child_frame_id for one in graph.read("/tf")}
    assert frames == {f"{begin}_device", f"{begin}_proxy"}
    (wall,) = graph.read(f"{prefix}/wall")
    assert (wall.type, wall.pose.position.z) == (CUBE, -0.001)
    first, *_ = graph.read(f"{prefix}/device/joints")
    state = next(iter(recording.messages("/device/state")))
    assert isinstance(state, DeviceState)
    assert (first.name, list(first.position)) == (["x", "y", "z"], list(state.position))
    stamp = first.header.stamp.sec * 10**9 + first.header.stamp.nanosec
    # A double at 1.8e9 s has a spacing of 2.4e-7 s.
    wall_time = 0 if pace == "lockstep" else 1764000000_123456789
    assert abs(stamp - round(state.stamp * 1e9) - wall_time) <= 240


def test_a_type_that_is_not_installed_is_left_out_and_said_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    graph, said = Graph(), list[tuple[str, str]]()
    found = graph.look_up

    def look_up(name: str) -> Any:
        if name.startswith(("tf2_msgs", "visualization_msgs")):
            raise ImportError(f"No module named {name.partition('/')[0]!r}")
        return found(name)

    graph.look_up = look_up
    monkeypatch.setattr(
        Events, "emit_each", lambda _, kind, text: said.append((kind, text))
    )
    node_on(graph, "", {"pace": "lockstep"}, "lockstep", {})
    missing = {"/tf", "/haptic/wall"}
    assert graph.kinds.keys() == ros2_topics(simulated=True).keys() - missing
    assert sorted(said) == [
        ("ros2", "/haptic/wall: left out: No module named 'visualization_msgs'"),
        ("ros2", "/tf: left out: No module named 'tf2_msgs'"),
    ]


class Endless:
    """An inbox into which more comes than anybody receives; at last it is empty."""

    def __init__(self, frames: list[bytes], node: Ros2) -> None:
        self.frames, self.node, self.left = frames, node, 100_000

    def receive(self, _: int) -> list[bytes] | None:
        """Return the same message again."""
        self.left -= 1
        if self.left == 0:
            self.node.stop("the test is over")
        return self.frames if self.left > 0 else None


def test_more_than_it_can_receive_does_not_silence_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """In a lockstep of 2.7 kHz on a busy machine it published the run's last state only."""
    graph = Graph()
    node = node_on(graph, "", {"pace": "lockstep"}, "lockstep", {})
    node._control = None
    monkeypatch.setattr(graph, "take", lambda: None, raising=False)
    state = DeviceState(seq=1, stamp=0.002, position=(0.0,) * 3, force=(0.0,) * 3)
    frames = [b"/device/state", msgspec.msgpack.encode(state)]
    node.inbox = Endless(frames, node)  # type: ignore[assignment]
    node._serve({frames[0]: "/device/state"}, 0.001)
    assert node.inbox.left == 0  # type: ignore[union-attr]
    # 100 000 receptions take a twentieth of a second and more, 50 periods.
    assert len(graph.told["/haptic/device/pose"]) > 10


ANGLE = st.floats(-math.pi, math.pi)


def matrix(turn: tuple[float, float, float, float]) -> Any:
    """Return the rotation matrix of a quaternion x, y, z, w (Rodrigues)."""
    x, y, z, w = turn
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + 2.0 * w * cross + 2.0 * cross @ cross


@given(st.tuples(ANGLE, ANGLE, ANGLE))
def test_a_marker_is_turned_as_the_box_that_is_touched(
    turn: tuple[float, float, float],
) -> None:
    # a dozen products of numbers below 1: 20 eps
    assert matrix(turned_by(turn)) == pytest.approx(np.array(rotation(turn)), abs=5e-15)


@given(ANGLE, st.floats(-1.0, 1.0))
def test_a_rod_and_a_plate_point_along_their_axis(angle: float, z: float) -> None:
    flat = math.sqrt(1.0 - z * z)
    unit = flat * math.cos(angle), flat * math.sin(angle), z
    # near -z the quaternion's w is the root of 1 + z, of which 1e-12 is taken for 0
    assert matrix(from_z_to(unit))[:, 2] == pytest.approx(np.array(unit), abs=2e-6)


def test_what_is_touched_is_drawn_where_it_is() -> None:
    plane = {"kind": "plane", "axis": "x", "position": 0.01, "normal": -1}
    (plate,) = drawn_shapes(plane)
    # The free side is towards smaller x: the plate of 2 mm lies behind it.
    assert plate.position == (0.011, 0.0, 0.0)
    leaning = {"kind": "oriented_plane", "normal": [0.0, 3.0, 4.0]}
    (plate,) = drawn_shapes(leaning)
    assert plate.position == pytest.approx((0.0, -0.0006, -0.0008), abs=1e-18)
    capsule = {"kind": "capsule", "start": [0, 0, 0], "end": [0, 0, 0.2], "radius": 0.1}
    rod, *ends = drawn_shapes({"kind": "union", "shapes": [capsule]})
    assert (rod.position, rod.size) == ((0.0, 0.0, 0.1), (0.2, 0.2, 0.2))
    assert [end.position for end in ends] == [(0.0, 0.0, 0.0), (0.0, 0.0, 0.2)]
    moving = {"kind": "sphere", "radius": 0.1, "motion": {"path": "x"}}
    for hidden in (moving, {"kind": "mesh", "file": "a.stl"}, {"kind": "free"}, None):
        assert drawn_shapes(hidden) == []
