"""Export a recording as a ROS 2 bag, for ``ros2 bag play``, RViz and PlotJuggler.

The bag is a folder with an MCAP file and ``metadata.yaml`` of version 8, which Humble and later
releases read. Stamps are wall-clock time, positions metres; frames follow REP 103 (x forward, y
left, z up), as ours do.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from messages import topics
from messages.types import DeviceState, Force, Message, NodeStatus, Proxy
from nodes.recording.export import parameters
from nodes.recording.reader import Recording
from nodes.recording.ros2_messages import RosMessages
from nodes.recording.wall_clock import CLOCK, read_offsets
from nodes.recording.writer import RecordError

# Topics of a chain in the bag and their types; with several chains, each prefixes its namespace.
CHAIN = (
    ("/haptic/device/pose", "geometry_msgs/msg/PoseStamped"),
    ("/haptic/device/force", "geometry_msgs/msg/WrenchStamped"),
    ("/haptic/device/joints", "sensor_msgs/msg/JointState"),
    ("/haptic/proxy/pose", "geometry_msgs/msg/PoseStamped"),
    ("/haptic/coupling/force", "geometry_msgs/msg/WrenchStamped"),
)
COMMON = (  # topics common to all chains
    ("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray"),
    ("/haptic/parameters", "std_msgs/msg/String"),
)


def _of(make: RosMessages, topic: str, message: Message, at: int) -> Iterator[tuple[str, Any]]:
    """Yield the ROS 2 messages (topic, message) of one recorded message."""
    chain, inside = topics.split(topic)
    if isinstance(message, NodeStatus):
        yield "/diagnostics", make.diagnostics(at, message)
    elif inside not in topics.LOOP:
        return
    elif isinstance(message, DeviceState):
        yield topics.within(chain, "/haptic/device/pose"), make.pose(at, message.position)
        yield topics.within(chain, "/haptic/device/force"), make.wrench(at, message.force)
        yield topics.within(chain, "/haptic/device/joints"), make.joints(at, message)
    elif isinstance(message, Proxy):
        yield topics.within(chain, "/haptic/proxy/pose"), make.pose(at, message.proxy)
    elif isinstance(message, Force):
        yield topics.within(chain, "/haptic/coupling/force"), make.wrench(at, message.force)


def export_ros2(recording: Recording, out: str | Path, *, overwrite: bool = False) -> list[Path]:
    """Write a ROS 2 bag; needs rosbags: ``pip install 'haptic-nodes[rosbag]'``."""
    try:
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise RecordError(
            "a ROS 2 bag needs rosbags: pip install 'haptic-nodes[rosbag]'"
        ) from error
    folder = Path(out)
    if folder.exists():
        if not overwrite:
            raise RecordError(
                f"{folder}: already exists; choose another name or ask to overwrite it"
            )
        if not (folder / "metadata.yaml").is_file():
            raise RecordError(f"{folder}: is not a bag, so it is not overwritten")
        shutil.rmtree(folder)
    offset = read_offsets(recording.metadata[CLOCK])[1] if CLOCK in recording.metadata else 0
    store = get_typestore(Stores.ROS2_HUMBLE)
    make = RosMessages(store.types.__getitem__)

    def serialised(message: Any) -> bytes:
        return bytes(store.serialize_cdr(message, message.__msgtype__))

    try:
        with Writer(folder, version=8, storage_plugin=StoragePlugin.MCAP) as writer:
            chains = {
                chain
                for chain, topic in map(topics.split, recording.topics)
                if topic in topics.LOOP
            } or {""}
            kinds = dict(COMMON) | {
                topics.within(chain, topic): kind
                for chain in sorted(chains)
                for topic, kind in CHAIN
            }
            lines = {
                topic: writer.add_connection(topic, kind, typestore=store)
                for topic, kind in kinds.items()
            }
            first = True
            for entry in recording.entries():
                at = round(entry.message.stamp * 1e9) + offset
                if first:
                    text = make.text(json.dumps(parameters(recording), ensure_ascii=False))
                    writer.write(lines["/haptic/parameters"], at, serialised(text))
                    first = False
                for topic, message in _of(make, entry.topic, entry.message, at):
                    writer.write(lines[topic], at, serialised(message))
    except OSError as error:
        raise RecordError(f"{error.filename or folder}: {error.strerror}") from error
    return sorted(folder.iterdir())
