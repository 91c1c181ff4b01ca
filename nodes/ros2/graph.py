"""Interface to a ROS 2 graph, the same for each library."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol

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
