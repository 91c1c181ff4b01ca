"""Kinds of node, found through the entry points ``haptic.nodes`` and imported when needed."""

import importlib

from messages import topics
from nodes.base.node import Node
from nodes.parameters.registry import Registry
from nodes.parameters.store import ParameterError

NODES = Registry(
    "haptic.nodes",
    "kind of node",
    lambda _, found: (
        ""
        if isinstance(found, type) and issubclass(found, Node)
        else f"{found!r} is not a subclass of Node"
    ),
)


def node_kinds() -> dict[str, str]:
    """Return all installed kinds of node: name to ``module:Class``."""
    return {name: point.value for name, point in NODES.points().items()}


def load(factory: str) -> type[Node]:
    """Return the class of a node kind."""
    module, _, name = factory.partition(":")
    try:
        found = getattr(importlib.import_module(module), name)
    # another package's module may raise anything on import
    except (Exception, SystemExit) as error:
        raise ParameterError(
            f"cannot be imported: {type(error).__name__}: {error}", path=factory
        ) from error
    if not (isinstance(found, type) and issubclass(found, Node)):
        raise ParameterError(
            f"{found!r} is registered as a kind of node, but is not a subclass of"
            " nodes.base.node.Node",
            path=factory,
        )
    return found


def drives(kind: type[Node]) -> bool:
    """Return whether nodes of a kind are the driver of a chain: they publish a device's state."""
    return topics.DEVICE_STATE in kind.publishes


def is_hop(kind: type[Node]) -> bool:
    """Return whether nodes of a kind are a part of the loop, not listeners."""
    return any(topic in kind.publishes for topic in topics.LOOP)
