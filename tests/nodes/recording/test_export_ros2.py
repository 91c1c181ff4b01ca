"""A recording as a ROS 2 bag, read back by two independent libraries."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import msgspec
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from messages.topics import within
from messages.types import DeviceState, Proxy
from nodes.cli.main import main
from nodes.recording.export_ros2 import export_ros2, within_chain
from nodes.recording.reader import Recording
from nodes.recording.ros2_messages import (
    LATCHED,
    MOST_SHAPES,
    RosMessages,
    standing_messages,
)
from nodes.recording.table import read
from nodes.recording.writer import RecordWriter
from tests.support.one_process import recorded
from tests.support.recorded import drop


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    return recorded(folder, "floor_drop", "duration:=0.4")


@pytest.fixture(scope="module")
def bag(recording: Path) -> Path:
    out = recording.with_name("bag")
    assert (
        main(["bag", "export", str(recording), "--format", "ros2", "--out", str(out)])
        == 0
    )
    return out


def test_ros_2_s_own_layout_reads_back(bag: Path, recording: Path) -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)
    table = read(recording)
    with Reader(bag) as reader:
        kinds = {line.topic: line.msgtype for line in reader.connections}
        assert kinds["/haptic/device/force"] == "geometry_msgs/msg/WrenchStamped"
        stamps, heights, forces = [], [], []
        for line, at, raw in reader.messages():
            message: Any = store.deserialize_cdr(raw, line.msgtype)
            if line.topic == "/haptic/device/pose":
                stamps.append(at)
                heights.append(message.pose.position.z)
                # In lockstep the stamps are of the simulated clock, as on a graph: T = 2 ms.
                of_run = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
                assert of_run == 2_000_000 * (len(stamps) - 1)
            if line.topic == "/haptic/coupling/force":
                forces.append(message.wrench.force.z)
    # CDR holds doubles: to the bit.
    assert heights == table["position"][:, 2].tolist()
    # The run's last state is answered by nobody, or too late to count.
    assert len(heights) - len(forces) in (0, 1)
    assert forces == table["force_asked"][: len(forces), 2].tolist()
    steps = {b - a for a, b in itertools.pairwise(stamps)}
    # T = 2 ms; a stamp is rounded to a nanosecond.
    assert all(abs(step - 2_000_000) <= 1 for step in steps)


def test_stamps_are_wall_clock_time(bag: Path, recording: Path) -> None:
    with open(next(bag.glob("*.mcap")), "rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        assert summary is not None
        assert {schema.encoding for schema in summary.schemas.values()} == {"ros2msg"}
        first = next(
            iter(reader.iter_decoded_messages(topics=["/haptic/device/force"]))
        )
    assert first.decoded_message.header.frame_id == "haptic_device"
    # A bag made today: the file's own time is the oracle, a run takes well under an hour.
    assert abs(first.message.log_time / 1e9 - recording.stat().st_mtime) < 3600.0
    assert "version: 8" in (bag / "metadata.yaml").read_text(encoding="utf-8")


def test_what_stands_there_is_kept(
    bag: Path, recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["bag", "export", str(recording), "--format", "ros2", "--out"]
    assert main([*words, str(bag)]) != 0
    assert "exists" in capsys.readouterr().err
    precious = bag.with_name("precious")
    precious.mkdir()
    (precious / "mine").write_text("mine")
    assert main([*words, str(precious), "--force"]) != 0
    assert "is not a bag" in capsys.readouterr().err
    assert (precious / "mine").exists()
    assert main([*words, str(bag), "--force"]) == 0
    assert Recording(recording).topics


def test_two_devices_have_topics_of_their_own(tmp_path: Path) -> None:
    path, out = tmp_path / "pair.mcap", tmp_path / "bag"
    chains = {"left": 0.0, "right": 1.0}
    with RecordWriter(path, {}) as writer:
        for topic, message in drop(20):
            for chain, x in chains.items():
                if isinstance(message, DeviceState | Proxy):
                    placed = msgspec.structs.replace(
                        message, position=(x, *message.position[1:])
                    )
                    writer.write(within(chain, topic), placed, message.stamp)
    export_ros2(Recording(path), out)
    store = get_typestore(Stores.ROS2_HUMBLE)
    with Reader(out) as reader:
        found: dict[str, list[Any]] = {}
        for line, _, raw in reader.messages():
            found.setdefault(line.topic, []).append(
                store.deserialize_cdr(raw, line.msgtype)
            )
    for chain, x in chains.items():
        # As the node ros2 names them on a graph.
        assert [
            pose.pose.position.x for pose in found[f"/{chain}/haptic/device/pose"]
        ] == [x] * 20
        assert len(found[f"/{chain}/haptic/proxy/pose"]) == 20
    assert "/haptic/device/pose" not in found


@pytest.mark.parametrize("number", [99, 100, 101])
def test_a_hundred_shapes_are_drawn_and_kept_for_who_comes_later(number: int) -> None:
    """A late subscriber gets as many markers as its queue keeps: all that are drawn."""
    ball = {"kind": "sphere", "position": [0.0, 0.0, 0.0], "radius": 0.01}
    surface = {"kind": "union", "shapes": [ball] * number}
    make = RosMessages(lambda name: pytest.fail(f"{name} is built before it is sent"))
    topics = [
        topic
        for topic, _, _ in standing_messages(make, {"wall": {"surface": surface}}, {})
    ]
    assert topics.count("/haptic/wall") == min(number, 100)
    assert topics.count("/haptic/parameters") == 1
    assert LATCHED["wall"] == MOST_SHAPES == 100


def test_the_nodes_of_a_chain_are_named_as_inside_it() -> None:
    """Neither another chain's, nor one inside it; a chain's own logger knows no other."""
    nodes = {"left/driver": 1, "left/arm/driver": 2, "right/driver": 3, "driver": 4}
    assert within_chain(nodes, "left") == {"driver": 1}
    assert within_chain(nodes, "left/arm") == {"driver": 2}
    assert within_chain(nodes, "") == {"driver": 4}
    assert within_chain({"driver": 1, "wall": 2}, "left") == {"driver": 1, "wall": 2}
