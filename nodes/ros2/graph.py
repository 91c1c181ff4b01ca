"""Interface to a ROS 2 graph, and the choice of the library."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib.util import find_spec
from typing import Any, Literal, Protocol

from nodes.parameters.store import ParameterError

Backend = Literal["auto", "rclpy", "cyclonedds"]

# sets parameters by their full names, all or none; returns why they were refused, or ""
SetParameters = Callable[[Mapping[str, Any]], str]

# carries out a request without arguments; returns whether it was, and what there is to say
Trigger = Callable[[], tuple[bool, str]]


class Graph(Protocol):
    """A participant of a ROS 2 graph, used by one thread."""

    def look_up(self, name: str) -> Any:
        """Return the constructor of a message type; ImportError if the type is not installed."""

    def publisher(
        self, topic: str, name: str, latched: int = 0
    ) -> Callable[[Any], None]:
        """Return a reliable publish function; a late subscriber gets the last `latched` ones."""

    def listen(self, topic: str, name: str, take: Callable[[Any], None]) -> None:
        """Subscribe to a topic, best effort, because an old force or target is useless."""

    def serve(self, change: SetParameters) -> bool:
        """Serve parameters and requests. Return whether the library can."""

    def show(self, values: Mapping[str, Any], about: Callable[[str], str]) -> None:
        """Show these parameters, and no others; `about` describes one by its name."""

    def offer(self, requests: Mapping[str, Trigger]) -> None:
        """Offer these requests as services below the node's name, and no others."""

    def take(self) -> None:
        """Deliver received messages to their subscribers, without waiting."""

    def close(self) -> None:
        """Leave the graph."""


def choose(backend: Backend, where: str) -> str:
    """Return the library to use: rclpy if it can be imported, else cyclonedds."""
    # Both are tested through their dependencies: rclpy reports a missing message package itself.
    there = {
        "rclpy": find_spec("rclpy") is not None,
        "cyclonedds": find_spec("cyclonedds") and find_spec("rosbags"),
    }
    for name, found in there.items():
        if found and backend in ("auto", name):
            return name
    if backend == "rclpy":
        raise ParameterError(
            "rclpy is not importable; source the setup file of your ROS 2 "
            "(source /opt/ros/DISTRO/setup.bash), with the Python that it was built for",
            path=f"{where}.backend",
        )
    raise ParameterError(
        "neither rclpy nor cyclonedds is there: pip install 'haptic-nodes[ros2]' brings"
        " Cyclone DDS; rclpy comes with a sourced ROS 2 (source /opt/ros/DISTRO/setup.bash), for"
        " tests pip install 'haptic-nodes[rclpy]'",
        path=where,
    )


def join(backend: str, name: str, namespace: str) -> Graph:
    """Join the graph of ROS_DOMAIN_ID."""
    if backend == "rclpy":
        from nodes.ros2.rclpy_graph import RclpyGraph

        return RclpyGraph(name, namespace)
    from nodes.ros2.dds_graph import DdsGraph

    return DdsGraph()
