"""A ROS 2 graph as the node needs it, and which library reaches it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib.util import find_spec
from typing import Any, Literal, Protocol

from nodes.parameters.store import ParameterError

Backend = Literal["auto", "rclpy", "cyclonedds"]

# sets a parameter by its full name; answers why it was refused, or nothing
SetParameter = Callable[[str, Any], str]


class Graph(Protocol):
    """A place on a ROS 2 graph. One thread uses it."""

    def look_up(self, name: str) -> Any:
        """Give what builds a message of a type, from its fields; ImportError where the type is not installed."""

    def publisher(self, topic: str, name: str) -> Callable[[Any], None]:
        """Offer a topic, reliable; gives what publishes on it."""

    def listen(self, topic: str, name: str, take: Callable[[Any], None]) -> None:
        """Listen to a topic, best effort: an old force or target is of no use."""

    def serve(self, values: Mapping[str, Any], change: SetParameter) -> bool:
        """Serve parameters, where the library can; whether it does."""

    def take(self) -> None:
        """Hand what has come to who listens, without waiting."""

    def close(self) -> None:
        """Leave the graph."""


def choose(backend: Backend, where: str) -> str:
    """Choose the library: rclpy where it imports, else cyclonedds."""
    # Both by what they need besides: rclpy without a message package says so itself.
    there = {
        "rclpy": find_spec("rclpy") is not None,
        "cyclonedds": find_spec("cyclonedds") and find_spec("rosbags"),
    }
    for name, found in there.items():
        if found and backend in ("auto", name):
            return name
    if backend == "rclpy":
        raise ParameterError(
            f"{where}.backend: rclpy is not importable; source the setup file of your ROS 2 "
            "(source /opt/ros/DISTRO/setup.bash), with the Python that it was built for"
        )
    raise ParameterError(
        f"{where}: neither rclpy nor cyclonedds is there: pip install 'haptic-nodes[ros2]' brings"
        " Cyclone DDS; rclpy comes with a sourced ROS 2 (source /opt/ros/DISTRO/setup.bash), for"
        " tests pip install 'haptic-nodes[rclpy]'"
    )


def join(backend: str, name: str, namespace: str) -> Graph:
    """Join the graph of ROS_DOMAIN_ID."""
    if backend == "rclpy":
        from nodes.ros2.rclpy_graph import RclpyGraph

        return RclpyGraph(name, namespace)
    from nodes.ros2.dds_graph import DdsGraph

    return DdsGraph()
