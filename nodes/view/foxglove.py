"""Live bridge to Foxglove and Lichtblick: topics with schemas, the scene, and parameters.

At most 60 messages a second per topic. The 3D scene is the topic ``/scene`` of Foxglove's own type:
its shape is sent once per subscriber, then poses.

An optional extra: ``pip install 'haptic-nodes[foxglove]'``. It is off by default, because
Foxglove's protocol has no token and its library does not report the Origin: any page in a browser
of this machine could connect to the port. Therefore it is read-only.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

import msgspec

from messages.schema import schema_json
from messages.topics import LOOP
from messages.types import DeviceState, Message, Proxy
from nodes.launcher.runs import RunInfo
from nodes.parameters.store import ParameterError
from nodes.view.commands import CommandError
from nodes.view.foxglove_scene import SCENE, SCHEMA, DrawnScene

RATE_LIMIT = 60.0  # messages per second and topic; Lichtblick warns above [1/s]


def load() -> Any:
    """Import the foxglove library."""
    try:
        import foxglove
    except ImportError as error:
        raise ParameterError(
            f"{error}; install it with: pip install 'haptic-nodes[foxglove]'",
            path="view.foxglove",
        ) from error
    return foxglove


class Bridge:
    """Publishes a run to Foxglove clients on 127.0.0.1.

    `do` sends requests to nodes on a thread of its own.
    """

    def __init__(self, run: RunInfo, do: Callable[..., Any], port: int) -> None:
        self._library = library = load()
        self._do, self._run, self._context = do, run, library.Context()
        self._channels: dict[str, Any] = {}
        self._next: dict[str, float] = {}
        self.sent = 0  # messages passed on
        period = next(setup.period for setup in run.nodes.values())
        self._scene = DrawnScene(
            {name: setup.parameters for name, setup in run.nodes.items()}, period
        )
        schema = library.Schema(
            name=SCHEMA["title"],
            encoding="jsonschema",
            data=msgspec.json.encode(SCHEMA),
        )
        # Advertised at once, so that every subscriber is noticed and gets the shape.
        self._drawn = library.Channel(
            SCENE, schema=schema, message_encoding="json", context=self._context
        )
        self._asked = True
        bridge = self

        class Listener(library.ServerListener):  # type: ignore[misc, name-defined]
            """Answers requests of clients, on the library's thread."""

            def on_subscribe(self, client: Any, channel: Any) -> None:
                del client
                bridge.subscribed(channel.topic)

            def on_get_parameters(
                self, client: Any, param_names: list[str], request_id: str | None = None
            ) -> list[Any]:
                del client, request_id
                return bridge.parameters(param_names)

            def on_set_parameters(
                self, client: Any, parameters: list[Any], request_id: str | None = None
            ) -> list[Any]:
                del client, request_id
                return bridge.refuse([one.name for one in parameters])

        try:
            self._server = library.start_server(
                name=run.run,
                host="127.0.0.1",
                port=port,
                capabilities=[library.Capability.Parameters],
                server_listener=Listener(),
                supported_encodings=["json"],
                context=self._context,
                session_id=run.run,
            )
        except Exception as error:  # the library raises its own types
            raise ParameterError(
                f"port {port}: {error}", path="view.foxglove"
            ) from error
        self.port: int = self._server.port  # where it is served

    def subscribed(self, topic: str) -> None:
        """Send the shape again for a new subscriber of the scene."""
        # Runs on the library's thread; `_draw` resets the flag before it sends.
        if topic == SCENE:
            self._asked = True

    def replace(self, node: str, parameters: Mapping[str, Any]) -> None:
        """Draw another surface of environment `node` from the next message on."""
        self._scene.replace(node, parameters)
        self._asked = True

    def _draw(self, topic: str, message: DeviceState | Proxy) -> None:
        at = self._wall(message)
        entities = list(self._scene.moving(topic, message, at))
        if self._asked:
            self._asked = False
            entities += self._scene.still(at)
        if entities:
            self._drawn.log(
                msgspec.json.encode({"deletions": [], "entities": entities}),
                log_time=at,
            )

    def _wall(self, message: Message) -> int:
        return max(0, round((message.stamp + self._run.wall_minus_monotonic) * 1e9))

    def take(self, topic: str, message: Message) -> None:
        """Forward a message, within the topic's rate limit."""
        if isinstance(message, DeviceState | Proxy):
            self._draw(topic, message)
        now = time.monotonic()
        if now < self._next.get(topic, 0.0):
            return
        # Even spacing for topics with a message per tick; rare messages pass at once.
        self._next[topic] = (
            now + 1.0 / RATE_LIMIT if topic in LOOP else now + 1.0 / RATE_LIMIT / 4.0
        )
        channel = self._channels.get(topic)
        if channel is None:
            kind = type(message)
            schema = self._library.Schema(
                name=f"haptic.{kind.__name__}",
                encoding="jsonschema",
                data=schema_json(kind),
            )
            channel = self._channels[topic] = self._library.Channel(
                topic, schema=schema, message_encoding="json", context=self._context
            )
        channel.log(msgspec.json.encode(message), log_time=self._wall(message))
        self.sent += 1

    def parameters(self, wanted: list[str]) -> list[Any]:
        """Return the wanted parameters of all nodes; all if `wanted` is empty."""
        found = []
        for node in self._run.nodes:
            try:
                values = self._do("ask", node, "param.list")
            except CommandError:
                # A node that has ended has no parameters.
                continue
            for path, value in values.items():
                if value is not None and (not wanted or f"{node}.{path}" in wanted):
                    kind = (
                        self._library.websocket.ParameterType.Float64
                        if isinstance(value, float)
                        else None
                    )
                    found.append(
                        self._library.Parameter(
                            f"{node}.{path}", value=value, type=kind
                        )
                    )
        return found

    def refuse(self, names: list[str]) -> list[Any]:
        """Report to the clients that parameters are read-only, and return them unchanged."""
        reason = (
            f"{', '.join(names)[:1000]}: this port is open to any local program, so parameters are"
            " read-only; use haptic param set"
        )
        self._server.publish_status(reason, self._library.websocket.StatusLevel.Error)
        return self.parameters(names)

    def tell_parameters(self) -> None:
        """Send the present parameters to all clients."""
        self._server.publish_parameter_values(self.parameters([]))

    def close(self) -> None:
        """Stop serving."""
        self._server.stop()
