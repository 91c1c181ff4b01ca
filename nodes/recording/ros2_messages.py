"""Build ROS 2 messages from ours, with the types of rosbags, rclpy or cyclonedds.

Positions are metres; frames follow REP 103 (x forward, y left, z up), as ours do.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from messages.types import DeviceState, NodeStatus, Vector

FRAME = "haptic"  # frame of all positions and forces
CUBE, SPHERE = 1, 2  # shapes of a marker


class RosMessages:
    """Builds ROS 2 messages.

    `look_up` returns the class of a type by its name, e.g. ``geometry_msgs/msg/PoseStamped``.
    """

    def __init__(self, look_up: Callable[[str], Any], frame: str = FRAME) -> None:
        self._type = look_up
        self._frame = frame

    def time(self, nanoseconds: int) -> Any:
        """Build a time."""
        return self._type("builtin_interfaces/msg/Time")(
            sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9
        )

    def header(self, nanoseconds: int) -> Any:
        """Build a header."""
        return self._type("std_msgs/msg/Header")(stamp=self.time(nanoseconds), frame_id=self._frame)

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
        return self._type("geometry_msgs/msg/WrenchStamped")(header=self.header(at), wrench=wrench)

    def joints(self, at: int, state: DeviceState) -> Any:
        """Build a joint state from the device's axes."""
        import numpy as np

        values = {
            "position": np.array(state.position),
            "velocity": np.zeros(0),
            "effort": np.array(state.force),
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
            pair(key=name, value=str(getattr(status, name))) for name in status.__struct_fields__
        ]
        level = kind.OK if status.state == "running" else kind.WARN
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
