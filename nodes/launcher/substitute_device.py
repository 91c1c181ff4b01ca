"""``device:=NAME``: a real device in the place of the virtual one that a launch file describes, in any launch that has one."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from typing import Any

import msgspec

from nodes.base.node import Node
from nodes.base.node_kinds import load, node_kinds
from nodes.launcher.launch_spec import Argument, NodeSpec
from nodes.parameters.store import ParameterError, merge

DEVICE = "device"
"""The argument."""
NONE = ("", "none")
"""What asks for no device."""
ARGUMENT = Argument(default="none", help="a real device whose known values are taken: haptic device presets")


def offered(nodes: Mapping[str, Any]) -> dict[str, Argument]:
    """Give the argument, where one of the nodes, as written, has a virtual device."""
    kinds = node_kinds()
    for node in nodes.values():
        # A kind that is not installed, or does not import, is refused when the launch is read.
        with contextlib.suppress(ParameterError, AttributeError, KeyError):
            if load(kinds[node["kind"]]).substitute_device.__func__ is not Node.substitute_device.__func__:  # type: ignore[attr-defined]
                return {DEVICE: ARGUMENT}
    return {}


def substituted(nodes: Mapping[str, NodeSpec], device: str, where: str) -> dict[str, NodeSpec]:
    """Put a real device in the place of every virtual one, and of the plant that a coupling judges its laws by."""
    kinds, found = node_kinds(), dict(nodes)
    plants: dict[str, dict[str, Any]] = {}
    for name, spec in nodes.items():
        stood = load(kinds[spec.kind]).substitute_device(spec.parameters, name, device)
        if stood is not None:
            parameters, plants[name.rpartition("/")[0]] = stood
            found[name] = msgspec.structs.replace(spec, parameters=parameters)
    if not plants:
        raise ParameterError(f"{where}: {DEVICE}:={device}: no node of it has a virtual device; leave it out")
    for name, spec in found.items():
        plant = plants.get(name.rpartition("/")[0])
        if plant is not None and isinstance(spec.parameters.get("plant"), Mapping):
            found[name] = msgspec.structs.replace(spec, parameters=merge(spec.parameters, {"plant": plant}))
    return found
