"""A ROS 2 graph without ROS: Cyclone DDS, with types from rosbags' definitions.

In DDS a topic ``/haptic/force`` is ``rt/haptic/force``, and a type ``std_msgs/msg/Bool`` is
``std_msgs::msg::dds_::Bool_``.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any

from nodes.recording.ros2_defaults import Constructors
from nodes.recording.ros2_messages import QUEUE
from nodes.ros2.graph import SetParameters, Trigger

_LENIENT = (  # types with sequences match those of other vendors by name only
    "<CycloneDDS><Domain><Compatibility><IgnoreTypeInformation>1.15</IgnoreTypeInformation>"
    "</Compatibility></Domain></CycloneDDS>"
)

# as ROS vendors do: no multicast, which a loopback may lack, but every port polled
_ON_THIS_MACHINE = (
    '<CycloneDDS><Domain><General><Interfaces><NetworkInterface name="lo"'
    ' multicast="false"/></Interfaces></General><Discovery>'
    "<ParticipantIndex>auto</ParticipantIndex>"
    "<MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>"
    '<Peers><Peer address="127.0.0.1"/></Peers></Discovery></Domain></CycloneDDS>'
)


class DdsGraph:
    """A participant of the domain ROS_DOMAIN_ID."""

    def __init__(self) -> None:
        local = (
            os.environ.get("ROS_LOCALHOST_ONLY") == "1"
            or os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE") == "LOCALHOST"
        )
        own = os.environ.get("CYCLONEDDS_URI", "")
        # The user's own settings come last and override.
        os.environ["CYCLONEDDS_URI"] = ",".join(
            filter(None, [_LENIENT, _ON_THIS_MACHINE if local else "", own])
        )
        typesys = import_module("rosbags.typesys")
        self._store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
        self._core = import_module("cyclonedds.core")
        self._participant = import_module("cyclonedds.domain").DomainParticipant(
            int(os.environ.get("ROS_DOMAIN_ID", "0"))
        )
        self._constructors = Constructors(self._store, self._class)
        self._classes: dict[str, Any] = {}
        self._readers: list[tuple[Any, Callable[[Any], None]]] = []

    def _field(self, description: Any) -> Any:
        """Return the type of a field that rosbags describes."""
        kind, inner = description
        types = import_module("cyclonedds.idl.types")
        if kind.name == "NAME":
            return self._class(inner)
        if kind.name == "BASE":
            name = {"octet": "uint8", "byte": "uint8", "char": "uint8"}.get(
                inner[0], inner[0]
            )
            return {"string": str, "bool": bool}.get(name) or getattr(types, name)
        of, length = inner
        return (
            types.array[self._field(of), length]
            if kind.name == "ARRAY"
            else types.sequence[self._field(of)]
        )

    def _class(self, name: str) -> Any:
        if name not in self._classes:
            _, fields = self._store.fielddefs[name]
            in_dds = f"{name.replace('/msg/', '::msg::dds_::')}_"
            described = {
                field: self._field(description) for field, description in fields
            }
            self._classes[name] = import_module("cyclonedds.idl").make_idl_struct(
                name.replace("/", "_"), in_dds, described
            )
        return self._classes[name]

    def look_up(self, name: str) -> Any:
        """Return a constructor of messages; missing fields are zero or empty, as in ROS."""
        return self._constructors.look_up(name)

    def _topic(self, topic: str, name: str) -> Any:
        return import_module("cyclonedds.topic").Topic(
            self._participant, f"rt{topic}", self._class(name)
        )

    def publisher(
        self, topic: str, name: str, latched: int = 0
    ) -> Callable[[Any], None]:
        """Return a publish function for a topic, with the type hash for newer ROS versions."""
        policy = self._core.Policy
        qos = self._core.Qos(
            policy.Reliability.Reliable(0),
            policy.History.KeepLast(latched or QUEUE),
            policy.Durability.TransientLocal if latched else policy.Durability.Volatile,
            policy.Userdata(f"typehash={self._store.hash_rihs01(name)};".encode()),
        )
        publishing = import_module("cyclonedds.pub")
        writer = publishing.DataWriter(
            publishing.Publisher(self._participant), self._topic(topic, name), qos
        )
        write: Callable[[Any], None] = writer.write
        return write

    def listen(self, topic: str, name: str, take: Callable[[Any], None]) -> None:
        """Subscribe to a topic."""
        policy = self._core.Policy
        qos = self._core.Qos(
            policy.Reliability.BestEffort, policy.History.KeepLast(QUEUE)
        )
        subscribing = import_module("cyclonedds.sub")
        reader = subscribing.DataReader(
            subscribing.Subscriber(self._participant), self._topic(topic, name), qos
        )
        self._readers.append((reader, take))

    def serve(self, change: SetParameters) -> bool:
        """Return False: parameters are services of a ROS node, which DDS alone lacks."""
        del change
        return False

    def show(self, values: Mapping[str, Any], about: Callable[[str], str]) -> None:
        """Do nothing: see `serve`."""

    def offer(self, requests: Mapping[str, Trigger]) -> None:
        """Do nothing: see `serve`."""

    def take(self) -> None:
        """Deliver received messages."""
        for reader, take in self._readers:
            for sample in reader.take(QUEUE):
                # A leaving writer appears as a sample without fields.
                if hasattr(sample, "header"):
                    take(sample)

    def close(self) -> None:
        """Leave the graph; the participant closes all its readers and writers."""
        self._readers.clear()
        del self._participant
