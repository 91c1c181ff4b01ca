"""Export a recording as a ROS 2 bag, for ``ros2 bag play``, RViz and PlotJuggler.

The bag is a folder with an MCAP file and ``metadata.yaml`` of version 8, which Humble and later
releases read. It has the topics, types, stamps and offered quality of service that the node
``ros2`` has live (`nodes.recording.ros2_messages`). Stamps are wall-clock time, of a lockstep run
its simulated time; positions are metres.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

from messages import topics
from messages.types import NodeStatus
from nodes.recording.export import parameters
from nodes.recording.reader import Recording
from nodes.recording.ros2_defaults import Constructors
from nodes.recording.ros2_messages import (
    QUEUE,
    RosMessages,
    ros2_messages,
    ros2_topics,
    standing_messages,
)
from nodes.recording.wall_clock import CLOCK, read_offsets
from nodes.recording.writer import RecordError


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
    store = get_typestore(Stores.ROS2_HUMBLE)
    constructors = Constructors(
        store, store.types.__getitem__, lambda name: np.empty(0, np.dtype(name))
    )
    make = RosMessages(
        constructors.look_up, sequence=partial(np.array, dtype=np.float64)
    )
    simulated = recording.manifest.get("pace") == "lockstep"
    # A bag's own times are dated; the stamps of a lockstep run are those of its clock, as live.
    dated = (
        read_offsets(recording.metadata[CLOCK])[1] if CLOCK in recording.metadata else 0
    )
    offset = 0 if simulated else dated
    found = {
        chain
        for chain, topic in map(topics.split, recording.topics)
        if topic in topics.LOOP
    }
    kinds: dict[str, tuple[str, int]] = {}
    # A recording of a single chain is read as if it were alone; on a graph it has its namespace.
    outer = recording.namespace
    for chain in sorted(found or {""}):
        kinds |= ros2_topics(_inside(outer, chain), simulated=simulated)
    about = parameters(recording)
    nodes = about.pop("parameters")
    laws: dict[str, str] = {}
    seen: set[str] = set()
    try:
        with Writer(folder, version=8, storage_plugin=StoragePlugin.MCAP) as writer:
            lines = {
                topic: writer.add_connection(
                    topic, kind, typestore=store, offered_qos_profiles=[_qos(latched)]
                )
                for topic, (kind, latched) in kinds.items()
            }

            def write(at: int, topic: str, message: Any) -> None:
                content = store.serialize_cdr(message, message.__msgtype__)
                writer.write(lines[topic], at, bytes(content))

            for entry in recording.entries():
                of_run = round(entry.message.stamp * 1e9)
                within, inside = topics.split(entry.topic)
                chain = _inside(outer, within)
                in_loop = inside in topics.LOOP
                if in_loop and chain not in seen:
                    seen.add(chain)
                    for topic, _, build in standing_messages(
                        make, within_chain(nodes, within), about, chain
                    ):
                        write(of_run + dated, topic, build())
                ours = in_loop or isinstance(entry.message, NodeStatus)
                for topic, _, build in (
                    ros2_messages(
                        make, entry.message, of_run + offset, chain, simulated=simulated
                    )
                    if ours
                    else ()
                ):
                    message = build()
                    if topic.endswith("/haptic/law"):
                        # as live: when it changes
                        if laws.get(topic) == message.data:
                            continue
                        laws[topic] = message.data
                    write(of_run + dated, topic, message)
    except OSError as error:
        raise RecordError(f"{error.filename or folder}: {error.strerror}") from error
    return sorted(folder.iterdir())


def _inside(outer: str, chain: str) -> str:
    """Return the full namespace of a chain, whose recording is in another one or in none."""
    return f"{outer}/{chain}".strip("/")


def within_chain(nodes: Mapping[str, Any], chain: str) -> dict[str, Any]:
    """Return the parameters of a chain's nodes, by their names inside it."""
    begin = f"{chain}/" if chain else ""
    inside = {
        name.removeprefix(begin): tree
        for name, tree in nodes.items()
        if name.startswith(begin) and "/" not in name.removeprefix(begin)
    }
    # A chain's own logger names the nodes as they are named inside it.
    return inside or dict(nodes)


def _qos(latched: int) -> Any:
    """Return what the node ``ros2`` offers live, for ``ros2 bag play``."""
    from rosbags.interfaces import (
        Qos,
        QosDurability,
        QosHistory,
        QosLiveliness,
        QosReliability,
        QosTime,
    )

    durability = QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE
    forever = QosTime(9223372036, 854775807)  # RMW_DURATION_INFINITE
    return Qos(
        QosHistory.KEEP_LAST,
        latched or QUEUE,
        QosReliability.RELIABLE,
        durability,
        forever,
        forever,
        QosLiveliness.AUTOMATIC,
        forever,
        False,
    )
