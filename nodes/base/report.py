"""What a node leaves behind at its end, where the launcher finds it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

if TYPE_CHECKING:
    from nodes.base.node import Node


def tick_of(node: Node) -> str:
    """Say which tick a node takes: ``compiled``, ``plain``, or nothing for one that takes none."""
    return "compiled" if node.kernel is not None else "plain" if node.publishes else ""


def write_report(node: Node, figures: Mapping[str, Any] | None = None) -> None:
    """Write a node's last status and its report."""
    path = Path(node.setup.run_dir) / f"{node.setup.name}.report.json"
    draft = path.with_suffix(".draft")
    told = node.report() if figures is None else figures
    status = msgspec.to_builtins(node.status())
    draft.write_bytes(
        msgspec.json.encode({"status": status, "tick": tick_of(node), "ticks_compiled": node.ticks_compiled, **told})
    )
    draft.replace(path)
