"""Kinds of node: found through the entry points ``haptic.nodes``, imported only when one is needed."""

from __future__ import annotations

import importlib
from importlib.metadata import entry_points

from nodes.base.node import Node

GROUP = "haptic.nodes"


def node_kinds() -> dict[str, str]:
    """Find all installed kinds of node.

    Returns
    -------
    dict of str to str
        Kind to ``module:Class``.
    """
    return {point.name: point.value for point in entry_points(group=GROUP)}


def load(factory: str) -> type[Node]:
    """Import the class of a node kind.

    Parameters
    ----------
    factory : str
        ``module:Class``.

    Returns
    -------
    type of Node
        The class.
    """
    module, _, name = factory.partition(":")
    found: type[Node] = getattr(importlib.import_module(module), name)
    return found
