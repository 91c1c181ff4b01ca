"""Bridges that ``haptic launch --ros2`` adds to a launch."""

from __future__ import annotations

from typing import Literal, get_args

import msgspec

from nodes.launcher.launch_spec import Launch, NodeSpec
from nodes.launcher.wiring import chains_of, free_name

KIND = "ros2"
Mode = Literal["read", "control"]
MODES: tuple[str, ...] = get_args(Mode)


def with_ros2(launch: Launch, mode: Mode) -> Launch:
    """Add a bridge to each chain without one; ``control`` lets the graph change things in all."""
    changes = {"control": True} if mode == "control" else {}
    nodes = {
        name: msgspec.structs.replace(spec, parameters={**spec.parameters, **changes})
        if spec.kind == KIND
        else spec
        for name, spec in launch.nodes.items()
    }
    has_one = {
        name.rpartition("/")[0] for name, spec in nodes.items() if spec.kind == KIND
    }
    added = NodeSpec(kind=KIND, required=False, respawn=True, parameters=changes)
    for chain in chains_of(launch):
        if chain not in has_one:
            wanted = f"{chain}/{KIND}" if chain else KIND
            nodes[free_name(launch, wanted)] = added
    return msgspec.structs.replace(launch, nodes=nodes)
