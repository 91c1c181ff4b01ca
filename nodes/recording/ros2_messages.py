"""Build ROS 2 messages from ours, with the types of rosbags, rclpy or cyclonedds.

Positions are metres; frames follow REP 103 (x forward, y left, z up), as ours do.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, TypeAlias

from messages.topics import within
from messages.types import DeviceState, Force, Message, NodeStatus, Proxy, Vector

FRAME = "haptic"  # frame of all positions and forces
CUBE, SPHERE = 1, 2  # shapes of a marker
POSE, WRENCH = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/WrenchStamped"
TF, DIAGNOSTICS = "/tf", "/diagnostics"

# topic, type, and the function that builds the message
RosMessage: TypeAlias = tuple[str, str, Callable[[], Any]]

# Topics of a chain and their types, the same live and in a bag; ``haptic`` may be another prefix.
CHAIN_TOPICS = {
    "device/pose": POSE,
    "device/force": WRENCH,
    "device/joints": "sensor_msgs/msg/JointState",
    "proxy/pose": POSE,
    "contact": "std_msgs/msg/Bool",
    "coupling/force": WRENCH,
    "law": "std_msgs/msg/String",
}
# Topics that all chains share.
SHARED_TOPICS = {
    TF: "tf2_msgs/msg/TFMessage",
    DIAGNOSTICS: "diagnostic_msgs/msg/DiagnosticArray",
}


def ros2_messages(
    make: RosMessages,
    message: Message,
    at: int,
    chain: str = "",
    prefix: str = "haptic",
) -> Iterator[RosMessage]:
    """Yield the ROS 2 messages of one of ours, as topic, type and a function that builds it.

    Parameters
    ----------
    make : RosMessages
        Builder.
    message : Message
        State, proxy, force, or status of a node; others have none.
    at : int
        Time [ns].
    chain : str
        Namespace of its chain; also begins the names of its frames.
    prefix : str
        Prefix of the chain's topics, after the namespace.
    """

    def inside(
        name: str, build: Callable[..., Any], *content: Any
    ) -> tuple[str, str, Callable[[], Any]]:
        return (
            within(chain, f"/{prefix}/{name}"),
            CHAIN_TOPICS[name],
            partial(build, *content),
        )

    def shared(
        topic: str, build: Callable[..., Any], *content: Any
    ) -> tuple[str, str, Callable[[], Any]]:
        return topic, SHARED_TOPICS[topic], partial(build, *content)

    frame = f"{chain}/{make.frame}" if chain else make.frame
    if isinstance(message, NodeStatus):
        yield shared(DIAGNOSTICS, make.diagnostics, at, message)
    elif isinstance(message, DeviceState):
        yield inside("device/pose", make.pose, at, message.position)
        yield inside("device/force", make.wrench, at, message.force)
        yield inside("device/joints", make.joints, at, message)
        yield shared(TF, make.transform, at, f"{frame}_device", message.position)
    elif isinstance(message, Proxy):
        yield inside("proxy/pose", make.pose, at, message.proxy)
        yield inside("contact", make.truth, message.contact)
        yield shared(TF, make.transform, at, f"{frame}_proxy", message.proxy)
    elif isinstance(message, Force):
        yield inside("coupling/force", make.wrench, at, message.force)
        yield inside("law", make.text, message.law)


class RosMessages:
    """Builds ROS 2 messages.

    `look_up` returns the class of a type by its name, e.g. ``geometry_msgs/msg/PoseStamped``;
    `sequence` makes the numbers of a field: a list, or for rosbags an array of numpy.
    """

    def __init__(
        self,
        look_up: Callable[[str], Any],
        frame: str = FRAME,
        sequence: Callable[[Sequence[float]], Any] = list,
    ) -> None:
        self._type, self._sequence = look_up, sequence
        self._frame = frame

    @property
    def frame(self) -> str:
        """Frame of all positions and forces."""
        return self._frame

    def time(self, nanoseconds: int) -> Any:
        """Build a time."""
        return self._type("builtin_interfaces/msg/Time")(
            sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9
        )

    def header(self, nanoseconds: int) -> Any:
        """Build a header."""
        return self._type("std_msgs/msg/Header")(
            stamp=self.time(nanoseconds), frame_id=self._frame
        )

    def vector(self, x: float, y: float, z: float) -> Any:
        """Build a vector."""
        return self._type("geometry_msgs/msg/Vector3")(x=x, y=y, z=z)

    def place(self, position: Vector) -> Any:
        """Build a pose without rotation."""
        x, y, z = position
        still = self._type("geometry_msgs/msg/Quaternion")(x=0.0, y=0.0, z=0.0, w=1.0)
        point = self._type("geometry_msgs/msg/Point")(x=x, y=y, z=z)
        return self._type("geometry_msgs/msg/Pose")(position=point, orientation=still)

    def pose(self, at: int, position: Vector) -> Any:
        """Build a stamped position; time in ns."""
        return self._type("geometry_msgs/msg/PoseStamped")(
            header=self.header(at), pose=self.place(position)
        )

    def wrench(self, at: int, force: Vector) -> Any:
        """Build a stamped force [N]; time in ns."""
        wrench = self._type("geometry_msgs/msg/Wrench")(
            force=self.vector(*force), torque=self.vector(0.0, 0.0, 0.0)
        )
        return self._type("geometry_msgs/msg/WrenchStamped")(
            header=self.header(at), wrench=wrench
        )

    def transform(self, at: int, child: str, position: Vector) -> Any:
        """Build a message of tf: a frame at a position, not turned; time in ns."""
        still = self._type("geometry_msgs/msg/Quaternion")(x=0.0, y=0.0, z=0.0, w=1.0)
        moved = self._type("geometry_msgs/msg/Transform")(
            translation=self.vector(*position), rotation=still
        )
        one = self._type("geometry_msgs/msg/TransformStamped")(
            header=self.header(at), child_frame_id=child, transform=moved
        )
        return self._type("tf2_msgs/msg/TFMessage")(transforms=[one])

    def joints(self, at: int, state: DeviceState) -> Any:
        """Build a joint state from the device's axes."""
        values = {
            "position": self._sequence(state.position),
            "velocity": self._sequence(()),
            "effort": self._sequence(state.force),
        }
        return self._type("sensor_msgs/msg/JointState")(
            header=self.header(at), name=["x", "y", "z"], **values
        )

    def diagnostics(self, at: int, status: NodeStatus) -> Any:
        """Build a diagnostic array from a node's status."""
        pair, kind = (
            self._type("diagnostic_msgs/msg/KeyValue"),
            self._type("diagnostic_msgs/msg/DiagnosticStatus"),
        )
        values = [
            pair(key=name, value=str(getattr(status, name)))
            for name in status.__struct_fields__
        ]
        # Cyclone's types have no constants: OK is 0, WARN 1.
        ok, warn = getattr(kind, "OK", 0), getattr(kind, "WARN", 1)
        level = ok if status.state == "running" else warn
        one = kind(
            level=level,
            name=status.node,
            message=status.state,
            hardware_id=status.kind,
            values=values,
        )
        return self._type("diagnostic_msgs/msg/DiagnosticArray")(
            header=self.header(at), status=[one]
        )

    def text(self, text: str) -> Any:
        """Build a string."""
        return self._type("std_msgs/msg/String")(data=text)

    def truth(self, value: bool) -> Any:
        """Build a boolean."""
        return self._type("std_msgs/msg/Bool")(data=value)

    def clock(self, nanoseconds: int) -> Any:
        """Build a message of simulated time."""
        return self._type("rosgraph_msgs/msg/Clock")(clock=self.time(nanoseconds))

    def marker(self, at: int, shape: int, position: Vector, size: Vector) -> Any:
        """Build a half-transparent shape for RViz."""
        color = self._type("std_msgs/msg/ColorRGBA")(r=0.3, g=0.5, b=0.8, a=0.5)
        seen: dict[str, Any] = {
            "type": shape,
            "pose": self.place(position),
            "scale": self.vector(*size),
            "color": color,
        }
        return self._type("visualization_msgs/msg/Marker")(
            header=self.header(at), ns=self._frame, **seen
        )
