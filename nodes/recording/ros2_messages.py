"""Build ROS 2 messages from ours, with the types of rosbags, rclpy or cyclonedds.

Positions are metres; frames follow REP 103 (x forward, y left, z up), as ours do.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, TypeAlias

from messages.topics import within
from messages.types import DeviceState, Force, Message, NodeStatus, Proxy, Vector
from nodes.recording.ros2_shapes import (
    NOT_TURNED,
    MarkerShape,
    Quaternion,
    drawn_shapes,
)
from nodes.recording.wall_clock import offsets_of

FRAME = "haptic"  # frame of all positions
POSE, WRENCH = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/WrenchStamped"
TEXT, MARKER = "std_msgs/msg/String", "visualization_msgs/msg/Marker"
TF, DIAGNOSTICS, CLOCK = "/tf", "/diagnostics", "/clock"
QUEUE = 10  # messages kept for a subscriber that is slow
MOST_SHAPES = 100  # shapes that are drawn

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
    "law": TEXT,
    "wall": MARKER,
    "parameters": TEXT,
}
# Latched topics of a chain (transient local), and how many messages a late subscriber receives.
LATCHED = {"law": 1, "wall": MOST_SHAPES, "parameters": 1}
# Topics that all chains share.
SHARED_TOPICS = {
    TF: "tf2_msgs/msg/TFMessage",
    DIAGNOSTICS: "diagnostic_msgs/msg/DiagnosticArray",
}
# Shared too, but in lockstep only.
SIMULATED_TOPICS = {CLOCK: "rosgraph_msgs/msg/Clock"}


def ros2_topics(
    chain: str = "", prefix: str = "haptic", simulated: bool = False
) -> dict[str, tuple[str, int]]:
    """Return all topics of a chain: full name to type and latched messages, 0 for none."""
    own = {
        within(chain, f"/{prefix}/{name}"): (kind, LATCHED.get(name, 0))
        for name, kind in CHAIN_TOPICS.items()
    }
    shared = SHARED_TOPICS | (SIMULATED_TOPICS if simulated else {})
    return own | {topic: (kind, 0) for topic, kind in shared.items()}


def stamp_offset(manifest: Mapping[str, str]) -> int:
    """Return what a ROS 2 stamp has more than a stamp of the run [ns]: 0 in lockstep."""
    return 0 if manifest.get("pace") == "lockstep" else offsets_of(manifest)[0]


def ros2_messages(
    make: RosMessages,
    message: Message,
    at: int,
    chain: str = "",
    prefix: str = "haptic",
    simulated: bool = False,
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
    simulated : bool
        Whether the run is in lockstep, with a simulated clock.
    """

    def inside(name: str, build: Callable[..., Any], *content: Any) -> RosMessage:
        return _of_chain(chain, prefix, name, partial(build, *content))

    def shared(topic: str, build: Callable[..., Any], *content: Any) -> RosMessage:
        kind = (SHARED_TOPICS | SIMULATED_TOPICS)[topic]
        return topic, kind, partial(build, *content)

    device, proxy = frames_of(make.frame, chain)
    if isinstance(message, NodeStatus):
        yield shared(DIAGNOSTICS, make.diagnostics, at, message)
    elif isinstance(message, DeviceState):
        if simulated:
            yield shared(CLOCK, make.clock, at)
        yield shared(TF, make.transform, at, device, message.position)
        yield inside("device/pose", make.pose, at, message.position)
        yield inside("device/force", make.wrench, at, message.force, device)
        yield inside("device/joints", make.joints, at, message)
    elif isinstance(message, Proxy):
        yield shared(TF, make.transform, at, proxy, message.proxy)
        yield inside("proxy/pose", make.pose, at, message.proxy)
        yield inside("contact", make.truth, message.contact)
    elif isinstance(message, Force):
        yield inside("coupling/force", make.wrench, at, message.force, device)
        yield inside("law", make.text, message.law)


def standing_messages(
    make: RosMessages,
    parameters: Mapping[str, Any],
    about: Mapping[str, Any],
    chain: str = "",
    prefix: str = "haptic",
) -> Iterator[RosMessage]:
    """Yield what stands while a chain runs: the shapes that are touched, and its parameters.

    Parameters
    ----------
    make : RosMessages
        Builder.
    parameters : mapping
        Parameters of each node of the chain.
    about : mapping
        What else the text of the topic ``parameters`` has, e.g. the manifest.
    chain, prefix : str
        As for `ros2_messages`.
    """
    for tree in parameters.values():
        surface = tree.get("surface") if isinstance(tree, Mapping) else None
        for number, shape in enumerate(drawn_shapes(surface)[:MOST_SHAPES]):
            build = partial(make.marker, number, shape)
            yield _of_chain(chain, prefix, "wall", build)
    text = json.dumps({**about, "parameters": parameters}, ensure_ascii=False)
    yield _of_chain(chain, prefix, "parameters", partial(make.text, text))


def _of_chain(
    chain: str, prefix: str, name: str, build: Callable[[], Any]
) -> RosMessage:
    return within(chain, f"/{prefix}/{name}"), CHAIN_TOPICS[name], build


def frames_of(frame: str, chain: str) -> tuple[str, str]:
    """Return the names of the frames of device and proxy, which are not turned."""
    begin = f"{chain}/{frame}" if chain else frame
    return f"{begin}_device", f"{begin}_proxy"


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

    def header(self, nanoseconds: int, frame: str = "") -> Any:
        """Build a header, in our frame unless another is named."""
        return self._type("std_msgs/msg/Header")(
            stamp=self.time(nanoseconds), frame_id=frame or self._frame
        )

    def vector(self, x: float, y: float, z: float) -> Any:
        """Build a vector."""
        return self._type("geometry_msgs/msg/Vector3")(x=x, y=y, z=z)

    def rotation(self, turn: Quaternion) -> Any:
        """Build a rotation."""
        x, y, z, w = turn
        return self._type("geometry_msgs/msg/Quaternion")(x=x, y=y, z=z, w=w)

    def place(self, position: Vector, turn: Quaternion = NOT_TURNED) -> Any:
        """Build a pose, without rotation unless one is given."""
        x, y, z = position
        point = self._type("geometry_msgs/msg/Point")(x=x, y=y, z=z)
        return self._type("geometry_msgs/msg/Pose")(
            position=point, orientation=self.rotation(turn)
        )

    def pose(self, at: int, position: Vector) -> Any:
        """Build a stamped position; time in ns."""
        return self._type("geometry_msgs/msg/PoseStamped")(
            header=self.header(at), pose=self.place(position)
        )

    def wrench(self, at: int, force: Vector, frame: str) -> Any:
        """Build a stamped force [N] that acts at the origin of a frame; time in ns."""
        wrench = self._type("geometry_msgs/msg/Wrench")(
            force=self.vector(*force), torque=self.vector(0.0, 0.0, 0.0)
        )
        return self._type("geometry_msgs/msg/WrenchStamped")(
            header=self.header(at, frame), wrench=wrench
        )

    def transform(self, at: int, child: str, position: Vector) -> Any:
        """Build a message of tf: a frame at a position, not turned; time in ns."""
        moved = self._type("geometry_msgs/msg/Transform")(
            translation=self.vector(*position), rotation=self.rotation(NOT_TURNED)
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
        pair = self._type("diagnostic_msgs/msg/KeyValue")
        kind = self._type("diagnostic_msgs/msg/DiagnosticStatus")
        values = [
            pair(key=name, value=str(getattr(status, name)))
            for name in status.__struct_fields__
        ]
        # Only the classes of rclpy have constants, which are bytes there.
        levels = {"running": ("OK", 0), "failed": ("ERROR", 2)}
        level = getattr(kind, *levels.get(status.state, ("WARN", 1)))
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

    def marker(self, number: int, drawn: MarkerShape) -> Any:
        """Build a half-transparent shape for RViz, with its number in the scene, at any time."""
        color = self._type("std_msgs/msg/ColorRGBA")(r=0.3, g=0.5, b=0.8, a=0.5)
        seen: dict[str, Any] = {
            "id": number,
            "type": drawn.shape,
            "pose": self.place(drawn.position, drawn.turn),
            "scale": self.vector(*drawn.size),
            "color": color,
        }
        return self._type(MARKER)(header=self.header(0), ns=self._frame, **seen)
