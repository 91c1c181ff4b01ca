"""A recording as a ROS 2 bag: ``ros2 bag play`` plays it, RViz and PlotJuggler show it.

A folder with an MCAP file and ``metadata.yaml`` of version 8, which Humble and all newer ones read. Stamps are
wall-clock time, positions metres; frames follow REP 103 (x forward, y left, z up), which is ours.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from messages import topics
from messages.types import DeviceState, Force, Message, NodeStatus, Proxy, Vector
from nodes.recording.export import parameters
from nodes.recording.reader import Recording
from nodes.recording.wall_clock import CLOCK, read_offsets
from nodes.recording.writer import RecordError

FRAME = "haptic"
"""Frame of all positions and forces."""

DESCRIPTION = (
    ("/haptic/device/pose", "geometry_msgs/msg/PoseStamped"),
    ("/haptic/device/force", "geometry_msgs/msg/WrenchStamped"),
    ("/haptic/device/joints", "sensor_msgs/msg/JointState"),
    ("/haptic/proxy/pose", "geometry_msgs/msg/PoseStamped"),
    ("/haptic/coupling/force", "geometry_msgs/msg/WrenchStamped"),
    ("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray"),
    ("/haptic/parameters", "std_msgs/msg/String"),
)
"""Topics of the bag, and their types."""


class _Messages:
    """Our messages as those of ROS 2."""

    def __init__(self, store: Any) -> None:
        self._store = store
        self.types = store.types

    def header(self, nanoseconds: int) -> Any:
        time = self.types["builtin_interfaces/msg/Time"](nanoseconds // 10**9, nanoseconds % 10**9)
        return self.types["std_msgs/msg/Header"](time, FRAME)

    def pose(self, at: int, position: Vector) -> Any:
        point = self.types["geometry_msgs/msg/Point"](*position)
        still = self.types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
        return self.types["geometry_msgs/msg/PoseStamped"](
            self.header(at), self.types["geometry_msgs/msg/Pose"](point, still)
        )

    def wrench(self, at: int, force: Vector) -> Any:
        vector = self.types["geometry_msgs/msg/Vector3"]
        wrench = self.types["geometry_msgs/msg/Wrench"](vector(*force), vector(0.0, 0.0, 0.0))
        return self.types["geometry_msgs/msg/WrenchStamped"](self.header(at), wrench)

    def joints(self, at: int, state: DeviceState) -> Any:
        import numpy as np

        return self.types["sensor_msgs/msg/JointState"](
            self.header(at),
            ["x", "y", "z"],
            np.array(state.position),
            np.zeros(0),
            np.array(state.force),
        )

    def diagnostics(self, at: int, status: NodeStatus) -> Any:
        pair, kind = self.types["diagnostic_msgs/msg/KeyValue"], self.types["diagnostic_msgs/msg/DiagnosticStatus"]
        values = [pair(name, str(getattr(status, name))) for name in status.__struct_fields__]
        level = kind.OK if status.state == "running" else kind.WARN
        one = kind(level, status.node, status.state, status.kind, values)
        return self.types["diagnostic_msgs/msg/DiagnosticArray"](self.header(at), [one])

    def text(self, text: str) -> Any:
        return self.types["std_msgs/msg/String"](text)

    def of(self, topic: str, message: Message, at: int) -> Iterator[tuple[str, Any]]:
        """Turn one recorded message into those of the bag."""
        if isinstance(message, DeviceState):
            yield "/haptic/device/pose", self.pose(at, message.position)
            yield "/haptic/device/force", self.wrench(at, message.force)
            yield "/haptic/device/joints", self.joints(at, message)
        elif isinstance(message, Proxy) and topic == topics.PROXY:
            yield "/haptic/proxy/pose", self.pose(at, message.proxy)
        elif isinstance(message, Force):
            yield "/haptic/coupling/force", self.wrench(at, message.force)
        elif isinstance(message, NodeStatus):
            yield "/diagnostics", self.diagnostics(at, message)

    def serialised(self, message: Any) -> bytes:
        return bytes(self._store.serialize_cdr(message, message.__msgtype__))


def export_ros2(recording: Recording, out: str | Path, *, overwrite: bool = False) -> list[Path]:
    """Write a ROS 2 bag; needs rosbags: pip install 'haptic-nodes[rosbag]'."""
    try:
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise RecordError("a ROS 2 bag needs rosbags: pip install 'haptic-nodes[rosbag]'") from error
    folder = Path(out)
    if folder.exists():
        if not overwrite:
            raise RecordError(f"{folder}: exists already; give another name or ask for it to be overwritten")
        if not (folder / "metadata.yaml").is_file():
            raise RecordError(f"{folder}: is no bag, and is not overwritten")
        shutil.rmtree(folder)
    offset = read_offsets(recording.metadata[CLOCK])[1] if CLOCK in recording.metadata else 0
    store = get_typestore(Stores.ROS2_HUMBLE)
    messages = _Messages(store)
    try:
        with Writer(folder, version=8, storage_plugin=StoragePlugin.MCAP) as writer:
            lines = {topic: writer.add_connection(topic, kind, typestore=store) for topic, kind in DESCRIPTION}
            first = True
            for entry in recording.entries():
                at = round(entry.message.stamp * 1e9) + offset
                if first:
                    text = messages.text(json.dumps(parameters(recording), ensure_ascii=False))
                    writer.write(lines["/haptic/parameters"], at, messages.serialised(text))
                    first = False
                for topic, message in messages.of(entry.topic, entry.message, at):
                    writer.write(lines[topic], at, messages.serialised(message))
    except OSError as error:
        raise RecordError(f"{error.filename or folder}: {error.strerror}") from error
    return sorted(folder.iterdir())
