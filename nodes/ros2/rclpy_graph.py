"""A ROS 2 graph through rclpy: a named node with parameters and services."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any

from nodes.recording.ros2_messages import QUEUE
from nodes.ros2.graph import SetParameters, Trigger


class RclpyGraph:
    """An rclpy node, listed by ``ros2 node list``."""

    def __init__(self, name: str, namespace: str) -> None:
        rclpy = self._rclpy = import_module("rclpy")
        context = import_module("rclpy.context")
        executors = import_module("rclpy.executors")
        signals = import_module("rclpy.signals")
        self._context = context.Context()
        # the launcher handles signals
        rclpy.init(
            args=[],
            context=self._context,
            signal_handler_options=signals.SignalHandlerOptions.NO,
        )
        self._node = rclpy.create_node(name, namespace=namespace, context=self._context)
        self._executor = executors.SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._shown: dict[str, Any] = {}
        self._showing = False  # whether a parameter is set by ourselves
        self._services: dict[str, Any] = {}
        self._received = False  # whether the executor had a message for us

    def look_up(self, name: str) -> Any:
        """Return the class of a message type."""
        package, kind, message = name.split("/")
        return getattr(import_module(f"{package}.{kind}"), message)

    def publisher(
        self, topic: str, name: str, latched: int = 0
    ) -> Callable[[Any], None]:
        """Return a publish function for a topic."""
        qos = import_module("rclpy.qos")
        durable = qos.DurabilityPolicy.TRANSIENT_LOCAL
        volatile = qos.DurabilityPolicy.VOLATILE
        profile = qos.QoSProfile(
            depth=latched or QUEUE, durability=durable if latched else volatile
        )
        publish: Callable[[Any], None] = self._node.create_publisher(
            self.look_up(name), topic, profile
        ).publish
        return publish

    def listen(self, topic: str, name: str, take: Callable[[Any], None]) -> None:
        """Subscribe to a topic."""
        sensor_data = import_module("rclpy.qos").qos_profile_sensor_data

        def receive(message: Any) -> None:
            self._received = True
            take(message)

        self._node.create_subscription(self.look_up(name), topic, receive, sensor_data)

    def serve(self, change: SetParameters) -> bool:
        """Serve parameters: ``ros2 param set`` sets them on their node and returns its refusal."""
        result = import_module("rcl_interfaces.msg").SetParametersResult

        def on_set(parameters: list[Any]) -> Any:
            given = {
                one.name: as_builtin(one.value)
                for one in parameters
                if one.name in self._shown
            }
            refused = "" if self._showing or not given else change(given)
            return result(successful=not refused, reason=refused)

        self._node.add_on_set_parameters_callback(on_set)
        return True

    def show(self, values: Mapping[str, Any], about: Callable[[str], str]) -> None:
        """Declare new parameters, set changed ones, and undeclare those that are gone."""
        description = import_module("rcl_interfaces.msg").ParameterDescriptor
        parameter = import_module("rclpy.parameter").Parameter
        self._showing = True
        try:
            for name in self._shown.keys() - values.keys():
                if self._node.has_parameter(name):
                    self._node.undeclare_parameter(name)
            for name, value in values.items():
                if not self._node.has_parameter(name):
                    told = description(description=about(name), dynamic_typing=True)
                    self._node.declare_parameter(name, value, told)
                    continue
                now = as_builtin(self._node.get_parameter(name).value)
                if type(now) is not type(value) or now != value:
                    self._node.set_parameters([parameter(name, value=value)])
        finally:
            self._showing = False
        self._shown = dict(values)

    def offer(self, requests: Mapping[str, Trigger]) -> None:
        """Create and destroy services ``~/NAME`` of the type ``std_srvs/srv/Trigger``."""
        trigger = import_module("std_srvs.srv").Trigger
        for name in self._services.keys() - requests.keys():
            self._node.destroy_service(self._services.pop(name))
        for name in requests.keys() - self._services.keys():

            def answer(_: Any, response: Any, name: str = name) -> Any:
                response.success, response.message = requests[name]()
                return response

            self._services[name] = self._node.create_service(
                trigger, f"~/{name}", answer
            )

    def take(self) -> None:
        """Deliver received messages, a limited number per call, or serve one request."""
        for _ in range(QUEUE):
            self._received = False
            self._executor.spin_once(timeout_sec=0.0)
            if not self._received:
                # A call takes some 80 µs even when there is nothing.
                break

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        self._node.destroy_node()
        self._rclpy.shutdown(context=self._context)


def as_builtin(value: Any) -> Any:
    """Return a parameter's value with a list in place of an array of rclpy."""
    is_plain = value is None or isinstance(value, (bool, int, float, str))
    return value if is_plain else list(value)
