"""Export a recording as a ROS 2 bag, for ``ros2 bag play``, RViz and PlotJuggler.

The bag is a folder with an MCAP file and ``metadata.yaml`` of version 8, which Humble and later
releases read. Stamps are wall-clock time, positions metres; frames follow REP 103 (x forward, y
left, z up), as ours do.
"""

from __future__ import annotations

import json
import shutil
from functools import partial
from pathlib import Path
from typing import Any

from messages import topics
from messages.types import NodeStatus
from nodes.recording.export import parameters
from nodes.recording.reader import Recording
from nodes.recording.ros2_messages import (
    CHAIN_TOPICS,
    SHARED_TOPICS,
    RosMessages,
    ros2_messages,
)
from nodes.recording.wall_clock import CLOCK, read_offsets
from nodes.recording.writer import RecordError

# Description of the run, in a bag only.
PARAMETERS = ("/haptic/parameters", "std_msgs/msg/String")


def export_ros2(
    recording: Recording, out: str | Path, *, overwrite: bool = False
) -> list[Path]:
    """Write a ROS 2 bag; needs rosbags: ``pip install 'haptic-nodes[rosbag]'``."""
    import numpy as np

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
    offset = (
        read_offsets(recording.metadata[CLOCK])[1] if CLOCK in recording.metadata else 0
    )
    store = get_typestore(Stores.ROS2_HUMBLE)
    make = RosMessages(
        store.types.__getitem__, sequence=partial(np.array, dtype=np.float64)
    )

    def serialised(message: Any) -> bytes:
        return bytes(store.serialize_cdr(message, message.__msgtype__))

    try:
        with Writer(folder, version=8, storage_plugin=StoragePlugin.MCAP) as writer:
            chains = {
                chain
                for chain, topic in map(topics.split, recording.topics)
                if topic in topics.LOOP
            } or {""}
            kinds = dict([PARAMETERS]) | SHARED_TOPICS
            for chain in sorted(chains):
                kinds |= {
                    topics.within(chain, f"/haptic/{name}"): kind
                    for name, kind in CHAIN_TOPICS.items()
                }
            laws: dict[str, str] = {}
            lines = {
                topic: writer.add_connection(topic, kind, typestore=store)
                for topic, kind in kinds.items()
            }
            first = True
            for entry in recording.entries():
                at = round(entry.message.stamp * 1e9) + offset
                if first:
                    text = make.text(
                        json.dumps(parameters(recording), ensure_ascii=False)
                    )
                    writer.write(lines["/haptic/parameters"], at, serialised(text))
                    first = False
                chain, inside = topics.split(entry.topic)
                ours = isinstance(entry.message, NodeStatus) or inside in topics.LOOP
                for topic, _, build in (
                    ros2_messages(make, entry.message, at, chain) if ours else ()
                ):
                    message = build()
                    if topic.endswith("/haptic/law"):
                        # as live: only when it changes
                        if laws.get(topic) == message.data:
                            continue
                        laws[topic] = message.data
                    writer.write(lines[topic], at, serialised(message))
    except OSError as error:
        raise RecordError(f"{error.filename or folder}: {error.strerror}") from error
    return sorted(folder.iterdir())
