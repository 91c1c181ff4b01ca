"""The forwarder: lets every user of this machine subscribe to the nodes that allow it.

A launch adds one if a node has ``open_port:``. It subscribes like any subscriber of the same user,
and publishes the same frames at those ports. Whatever strangers do, they reach no process of the
loop: only the forwarder dies, and is restarted while the launch runs.
"""

from collections.abc import Callable, Iterable
from typing import Annotated, Any, ClassVar

import msgspec
import zmq

from messages.transport.context import new_context
from messages.transport.open_port import OpenPort
from messages.transport.sockets import Subscription
from nodes.base.node import IDLE_MS, Node
from nodes.base.setup import Setup

QUEUE = 20_000  # messages queued while strangers keep this process busy
LAST_MS = 50  # silence after which all messages are forwarded at the end [ms]


class ForwarderParameters(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True
):
    """Parameters of a forwarder.

    ports: Node to the tcp port on loopback at which everybody may subscribe to it.
    """

    ports: dict[str, Annotated[int, msgspec.Meta(ge=1, le=65535)]]


class Forwarder(Node):
    """Publishes the messages of some nodes to all users of this machine."""

    Parameters: ClassVar[type[msgspec.Struct]] = ForwarderParameters
    listens_to: ClassVar[tuple[str, ...]] = ("*",)

    @classmethod
    def hears(cls, parameters: Any, nodes: Iterable[str]) -> frozenset[str]:
        """Return the nodes that it subscribes to."""
        return frozenset(parameters.ports).intersection(nodes)

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self._lines: list[tuple[Subscription, OpenPort]] = []

    def configure(self) -> None:
        """Open the ports, so that an occupied one fails the start."""
        parameters: ForwarderParameters = self.store.current
        self._strangers = new_context()
        self._ports = {
            node: OpenPort(self._strangers, f"tcp://127.0.0.1:{port}", self.events.deny)
            for node, port in parameters.ports.items()
        }

    def connect(
        self, subscribe: Callable[[Iterable[str], Iterable[str], int], Subscription]
    ) -> None:
        """Subscribe to the nodes."""
        for node, port in self._ports.items():
            self._lines.append(
                (subscribe([self.setup.sources[node]], [""], QUEUE), port)
            )

    def _pass_on(
        self, subscription: Subscription, port: OpenPort, timeout_ms: int = 0
    ) -> bool:
        frames = subscription.receive(timeout_ms)
        if frames is None:
            return False
        port.send(*frames)
        self.received += 1
        self.counters.ticks += 1
        return True

    def loop(self) -> None:
        """Forward messages until stopped, then those in flight."""
        self.state = "running"
        poller = zmq.Poller()
        for subscription, _ in self._lines:
            subscription.register(poller)
        while not self.stopping:
            poller.poll(IDLE_MS)
            for line in self._lines:
                # Bounded, so that a busy node does not block the others.
                for _ in range(QUEUE):
                    if not self._pass_on(*line):
                        break
                line[1].keep()
            self.between_ticks(0)
        for line in self._lines:
            while self._pass_on(*line, timeout_ms=LAST_MS):
                pass

    def finish(self) -> None:
        """Close the ports."""
        for subscription, port in self._lines:
            subscription.close()
            port.close()
        self._strangers.term()
