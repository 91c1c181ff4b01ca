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


def parameters(rclpy: Any, node: Any, name: str) -> dict[str, Any]:
    """Read and set parameters of a node, and switch its law; return what came of it."""
    from rclpy.parameter import Parameter
    from rclpy.parameter_client import AsyncParameterClient
    from std_srvs.srv import Trigger

    client = AsyncParameterClient(node, name)
    client.wait_for_services(10.0)
    stiffness, damping = "coupling.laws.pd.stiffness", "coupling.laws.pd.damping"

    def wait(future: Any) -> Any:
        rclpy.spin_until_future_complete(node, future, timeout_sec=15.0)
        return future.result()

    def change(together: bool, **values: Any) -> list[Any]:
        made = [Parameter(one.replace("__", "."), value=v) for one, v in values.items()]
        if together:
            result = wait(client.set_parameters_atomically(made)).result
        else:
            (result,) = wait(client.set_parameters(made)).results
        return [result.successful, result.reason]

    told: dict[str, Any] = {}
    # The node shows its chain's parameters as soon as the chain answers.
    while stiffness not in wait(client.list_parameters()).result.names:
        time.sleep(0.05)
    told["good"] = change(
        True, coupling__laws__pd__stiffness=700, coupling__laws__pd__damping=3.0
    )
    told["bad"] = change(False, coupling__laws__pd__stiffness=-1.0)
    told["none_of_two"] = change(
        True, coupling__laws__pd__damping=4.0, coupling__laws__pd__stiffness=-1.0
    )
    told["law"] = change(False, coupling__law="pd_alpha")
    service = node.create_client(Trigger, f"{name}/law/multi_term")
    service.wait_for_service(10.0)
    answer = wait(service.call_async(Trigger.Request()))
    told["switched"] = [answer.success, answer.message]
    # What the law became is shown, as the project has it: 700 as a double.
    deadline = time.time() + 10.0
    shown = ["coupling.law", stiffness, damping]
    while time.time() < deadline:
        values = wait(client.get_parameters(shown)).values
        told["shown"] = [
            values[0].string_value,
            values[1].double_value,
            values[2].double_value,
        ]
        if told["shown"][0] == "multi_term":
            break
        time.sleep(0.05)
    told["about"] = (
        wait(client.describe_parameters([stiffness])).descriptors[0].description
    )
    told["nodes"] = sorted(
        f"{space.rstrip('/')}/{one}"
        for one, space in node.get_node_names_and_namespaces()
    )
    return told


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
        # as a sensor's has; the scene computes x alone
        message.wrench.force.y = 0.1 * PUSH
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
        told |= parameters(rclpy, node, f"{namespace}/ros2")
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
    told["force_frame"] = got["device/force"][0].header.frame_id
    told["contact"] = sorted({m.data for m in got["contact"]})
    print(json.dumps(told), flush=True)


if __name__ == "__main__":
    main(float(sys.argv[1]), sys.argv[2] == "parameters", sys.argv[3])
