"""An independent ROS 2 node: subscribes, pushes, pulls, sets parameters, prints JSON.

Run by a Python that has rclpy: ``python rclpy_probe.py SECONDS parameters|plain NAMESPACE``; the
namespace may be empty.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from typing import Any

PUSH, PULL = 0.5, 0.012


# Long: one run of a program that a test starts, in the order of its steps.
def main(seconds: float, with_parameters: bool, namespace: str) -> None:  # noqa: PLR0915
    """Run the probe."""
    import rclpy
    from geometry_msgs.msg import PoseStamped, WrenchStamped
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Bool, String

    rclpy.init()
    node = rclpy.create_node("probe")
    got: dict[str, list[Any]] = {}
    told: dict[str, Any] = {}

    def keep(topic: str) -> Callable[[Any], None]:
        got[topic] = []
        return lambda message: got[topic].append(message)

    for topic, kind in (
        ("device/pose", PoseStamped),
        ("device/force", WrenchStamped),
        ("device/joints", JointState),
        ("proxy/pose", PoseStamped),
        ("coupling/force", WrenchStamped),
        ("contact", Bool),
        ("law", String),
    ):
        node.create_subscription(kind, f"{namespace}/haptic/{topic}", keep(topic), 100)
    wrench = node.create_publisher(WrenchStamped, f"{namespace}/haptic/wrench", 10)
    target = node.create_publisher(PoseStamped, f"{namespace}/haptic/target", 10)

    def spin(until: float, between: Callable[[], None] | None = None) -> None:
        while time.time() < until:
            rclpy.spin_once(node, timeout_sec=0.01)
            if between is not None:
                between()

    deadline = time.time() + 20.0
    while time.time() < deadline and not (
        all(got.values()) and wrench.get_subscription_count()
    ):
        rclpy.spin_once(node, timeout_sec=0.05)

    def push(late: float = 0.0) -> None:
        message = WrenchStamped()
        at = time.time() - late
        message.header.stamp.sec, message.header.stamp.nanosec = (
            int(at),
            int(at % 1.0 * 1e9),
        )
        message.wrench.force.x = PUSH
        message.wrench.force.y = (
            0.1 * PUSH
        )  # as a sensor's has; the scene computes x alone
        wrench.publish(message)

    def pull() -> None:
        message = PoseStamped()
        message.pose.position.x = PULL
        target.publish(message)

    def first(message: Any) -> float:
        return float(message.header.stamp.sec + message.header.stamp.nanosec * 1e-9)

    told["old_from"] = time.time()
    spin(time.time() + 0.3, lambda: push(late=5.0))
    told["pushed_from"] = time.time()
    spin(time.time() + seconds, push)
    told["pushed_to"] = time.time()
    spin(time.time() + seconds, pull)
    told["pulled_to"] = time.time()
    spin(time.time() + 0.2)
    if with_parameters:
        from rclpy.parameter import Parameter
        from rclpy.parameter_client import AsyncParameterClient

        client = AsyncParameterClient(node, "ros2")
        client.wait_for_services(5.0)
        for name, value in (("good", 700.0), ("bad", -1.0)):
            future = client.set_parameters(
                [Parameter("coupling.laws.pd.stiffness", value=value)]
            )
            rclpy.spin_until_future_complete(node, future, timeout_sec=5.0)
            answer: Any = future.result()
            result = answer.results[0]
            told[name] = [result.successful, result.reason]
        told["nodes"] = node.get_node_names()
    told["types"] = dict(node.get_topic_names_and_types())
    told["counts"] = {topic: len(found) for topic, found in got.items()}
    told["poses"] = [
        [
            m.header.stamp.sec,
            m.header.stamp.nanosec,
            m.pose.position.x,
            m.pose.position.y,
            m.pose.position.z,
        ]
        for m in got["device/pose"]
    ]
    told["joints"] = [
        [m.name, list(m.position), list(m.effort)] for m in got["device/joints"]
    ]
    told["span"] = first(got["device/pose"][-1]) - first(got["device/pose"][0])
    told["frame"] = got["device/pose"][0].header.frame_id
    told["laws"] = sorted({m.data for m in got["law"]})
    told["contact"] = sorted({m.data for m in got["contact"]})
    print(json.dumps(told), flush=True)


if __name__ == "__main__":
    main(float(sys.argv[1]), sys.argv[2] == "parameters", sys.argv[3])
