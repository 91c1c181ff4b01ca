"""Loading a node's compiled ticks at its start, with few imports for plain launches."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from nodes.base.node import Node


def load_kernel(node: Node) -> None:
    """Load a node's compiled ticks, if requested; without them the plain ones run."""
    if node.setup.tick == "compiled" and node.kernel_module:
        from nodes.compiled.library import obtain
        from nodes.compiled.message_fields import NotCompilableError

        try:
            node.kernel = obtain(node.kernel_of(node.setup.parameters))
        except NotCompilableError as error:
            node.events.emit("tick", f"plain: {error}")
