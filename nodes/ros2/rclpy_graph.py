"""A ROS 2 graph through rclpy: a named node with parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any

QUEUE = 10


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

    def look_up(self, name: str) -> Any:
        """Return the class of a message type."""
        package, kind, message = name.split("/")
        return getattr(import_module(f"{package}.{kind}"), message)

    def publisher(self, topic: str, name: str) -> Callable[[Any], None]:
        """Return a publish function for a topic."""
        publish: Callable[[Any], None] = self._node.create_publisher(
            self.look_up(name), topic, QUEUE
        ).publish
        return publish

    def listen(self, topic: str, name: str, take: Callable[[Any], None]) -> None:
        """Subscribe to a topic."""
        sensor_data = import_module("rclpy.qos").qos_profile_sensor_data
        self._node.create_subscription(self.look_up(name), topic, take, sensor_data)

    def serve(
        self, values: Mapping[str, Any], change: Callable[[str, Any], str]
    ) -> bool:
        """Serve parameters: ``ros2 param set`` sets them on their node and returns its refusal."""
        result = import_module("rcl_interfaces.msg").SetParametersResult
        dynamic = import_module("rcl_interfaces.msg").ParameterDescriptor

        def on_set(parameters: list[Any]) -> Any:
            for parameter in parameters:
                if parameter.name in values and (
                    refused := change(parameter.name, parameter.value)
                ):
                    return result(successful=False, reason=refused)
            return result(successful=True)

        for name, value in values.items():
            self._node.declare_parameter(name, value, dynamic(dynamic_typing=True))
        self._node.add_on_set_parameters_callback(on_set)
        return True

    def take(self) -> None:
        """Deliver received messages, a limited number per call."""
        for _ in range(QUEUE):
            self._executor.spin_once(timeout_sec=0.0)

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        self._node.destroy_node()
        self._rclpy.shutdown(context=self._context)
