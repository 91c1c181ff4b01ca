"""The library through which a ROS 2 graph is reached."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Literal

from nodes.parameters.store import ParameterError
from nodes.ros2.dds_graph import DdsGraph
from nodes.ros2.graph import Graph
from nodes.ros2.rclpy_graph import RclpyGraph

Backend = Literal["auto", "rclpy", "cyclonedds"]


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
    return RclpyGraph(name, namespace) if backend == "rclpy" else DdsGraph()
