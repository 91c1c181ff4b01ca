"""A law that a launch is given by kind and parameters, in place of a law's name.

``law:='{kind: pd, stiffness: 800}'`` on the command line and ``law=haptic.PD(stiffness=800)`` in
Python both arrive as a mapping where the coupling expects a name. It joins the coupling's laws.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgspec

from nodes.base.node_kinds import load, node_kinds
from nodes.coupling.law_book import free_name
from nodes.launcher.launch_spec import NodeSpec
from nodes.laws.parse import parse_law


def with_named_law(spec: NodeSpec, node: str) -> NodeSpec:
    """Return a node whose ``law`` is a name; a law that was given joins ``laws``.

    Raises LawRefusedError with the path ``node.law`` if the law is invalid.
    """
    given = spec.parameters.get("law")
    if not isinstance(given, Mapping):
        return spec
    fields = load(node_kinds()[spec.kind]).Parameters.__struct_fields__
    laws: Any = spec.parameters.get("laws") or {}
    if not ({"law", "laws"} <= set(fields) and isinstance(laws, Mapping)):
        return spec  # the node's own check refuses it
    parse_law(given, f"{node}.law")
    name = free_name(given, laws)
    parameters = {**spec.parameters, "law": name, "laws": {**laws, name: dict(given)}}
    return msgspec.structs.replace(spec, parameters=parameters)
