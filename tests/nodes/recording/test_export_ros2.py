"""A recording as a ROS 2 bag: read back by two libraries that know nothing of us."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from nodes.cli.main import main
from nodes.recording.reader import Recording
from nodes.recording.table import read
from tests.support.launching import launch_json


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    return folder / str(launch_json(folder, "floor_drop", "duration:=0.4", "pace:=lockstep")["recording"])


@pytest.fixture(scope="module")
def bag(recording: Path) -> Path:
    out = recording.with_name("bag")
    assert main(["bag", "export", str(recording), "--format", "ros2", "--out", str(out)]) == 0
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
                assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == at
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
        first = next(iter(reader.iter_decoded_messages(topics=["/haptic/device/force"])))
    assert first.decoded_message.header.frame_id == "haptic"
    # A bag made today: the file's own time is the oracle, a run takes well under an hour.
    assert abs(first.message.log_time / 1e9 - recording.stat().st_mtime) < 3600.0
    assert "version: 8" in (bag / "metadata.yaml").read_text(encoding="utf-8")


def test_what_stands_there_is_kept(bag: Path, recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["bag", "export", str(recording), "--format", "ros2", "--out"]
    assert main([*words, str(bag)]) != 0
    assert "exists" in capsys.readouterr().err
    precious = bag.with_name("precious")
    precious.mkdir()
    (precious / "mine").write_text("mine")
    assert main([*words, str(precious), "--force"]) != 0
    assert "is no bag" in capsys.readouterr().err
    assert (precious / "mine").exists()
    assert main([*words, str(bag), "--force"]) == 0
    assert Recording(recording).topics
