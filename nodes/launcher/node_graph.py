"""The graph of a launch: who publishes a topic, who relays it, and who hears whom."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from messages import topics
from nodes.base.node import Node
from nodes.base.node_kinds import load, node_kinds
from nodes.launcher.launch_spec import Launch
from nodes.parameters.refusals import choices
from nodes.parameters.store import ParameterError, convert


def full_names(name: str, names: Iterable[str]) -> Iterator[str]:
    """Return the full names of topics inside the chain of a node."""
    return (topics.within(name.rpartition("/")[0], topic) for topic in names)


def _followed(launch: Launch, name: str, topic: str) -> str:
    """Return the full name of the topic that a node receives for one of its chain."""
    return launch.nodes[name].remap.get(topic) or next(full_names(name, [topic]))


class NodeGraph:
    """The nodes of a launch by topic.

    Attributes
    ----------
    classes : dict of str to type of Node
        Class of each node.

    Raises
    ------
    ParameterError
        For a topic that two nodes publish or relay, or that is followed and nobody publishes.
    """

    def __init__(self, launch: Launch) -> None:
        self._launch = launch
        factories = node_kinds()
        self.classes = {
            name: load(factories[spec.kind]) for name, spec in launch.nodes.items()
        }
        self._publisher = self._publishers()
        for name, kind in self.classes.items():
            self._check_remap(name, kind)
            self._check_sources(name, kind)
        self._relays = self._relaying()
        parameters = {
            name: convert(launch.nodes[name].parameters, kind.Parameters, name)
            for name, kind in self.classes.items()
        }
        self._subscribes = {
            name: len(kind.subscribes(parameters[name]))
            for name, kind in self.classes.items()
        }
        # Nodes heard by each listener to everything.
        self._heard = {
            name: kind.hears(parameters[name], _audible(launch, name))
            for name, kind in self.classes.items()
            if "*" in kind.listens_to
        }

    def source_of(self, listener: str, topic: str) -> str:
        """Return the node from which a listener gets a topic of its chain: the relay, if any."""
        full = _followed(self._launch, listener, topic)
        # A relay stands between the publisher and everybody else.
        relay = self._relays.get(full, listener)
        return self._publisher[full] if relay == listener else relay

    def hears(self, listener: str, source: str) -> bool:
        """Return whether a node listens to another one."""
        if source in self._heard.get(listener, ()):
            return True
        followed = (
            topic for topic in self.classes[listener].listens_to if topic != "*"
        )
        return any(self.source_of(listener, topic) == source for topic in followed)

    def heard_by(self, listener: str) -> list[str]:
        """Return the nodes that one which listens to everything hears, in the launch's order."""
        return [name for name in self._launch.nodes if name in self._heard[listener]]

    def listeners(self, source: str) -> int:
        """Return how many subscriptions a node's publisher has."""
        others = (name for name in self._launch.nodes if name != source)
        return sum(
            self._subscribes[name] for name in others if self.hears(name, source)
        )

    def _where(self, name: str) -> str:
        return f"{self._launch.scenario}.nodes.{name}"

    def _publishers(self) -> dict[str, str]:
        """Return the node that publishes each topic, by the topic's full name."""
        publisher: dict[str, str] = {}
        for name, kind in self.classes.items():
            for topic in full_names(name, kind.publishes):
                if topic in publisher:
                    raise ParameterError(
                        f"{topic} is already published by"
                        f" {publisher[topic]}; a second chain needs a namespace of its own, as in"
                        " right/driver",
                        path=self._where(name),
                    )
                publisher[topic] = name
        return publisher

    def _relaying(self) -> dict[str, str]:
        """Return the node that relays a topic, by the topic's full name."""
        relays: dict[str, str] = {}
        for name, kind in self.classes.items():
            for topic in full_names(name, kind.relays):
                if topic in relays:
                    raise ParameterError(
                        f"{topic} is already relayed by {relays[topic]}",
                        path=self._where(name),
                    )
                relays[topic] = name
        return relays

    def _check_remap(self, name: str, kind: type[Node]) -> None:
        where = f"{self._where(name)}.remap"
        spec = self._launch.nodes[name]
        for topic, instead in spec.remap.items():
            if topic not in kind.listens_to:
                if kind.listens_to in ((), ("*",)):
                    raise ParameterError(
                        f"a {spec.kind} listens to no single topic that could be another",
                        path=where,
                    )
                raise ParameterError(
                    f"the node does not listen to {topic!r}; {choices(topic, kind.listens_to)}",
                    path=where,
                )
            if topics.message_type(topic) is not topics.message_type(instead):
                raise ParameterError(
                    f"{instead!r} does not carry the same messages",
                    path=f"{where}.{topic}",
                )

    def _check_sources(self, name: str, kind: type[Node]) -> None:
        for topic in kind.listens_to:
            if topic == "*":
                continue
            full = _followed(self._launch, name, topic)
            if full not in self._publisher:
                raise ParameterError(
                    f"listens to {full}, which no node publishes; {choices(full, self._publisher)}",
                    path=self._where(name),
                )


def _audible(launch: Launch, name: str) -> set[str]:
    """Return the nodes of a listener's namespace; all nodes for one outside of any."""
    namespace = name.rpartition("/")[0]
    return {
        other
        for other in launch.nodes
        if other != name and (not namespace or other.startswith(f"{namespace}/"))
    }
