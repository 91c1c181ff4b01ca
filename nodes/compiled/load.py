"""Give a node its compiled ticks as it starts; light, because plain launches import it too."""

from typing import Any


def load_kernel(node: Any) -> None:
    """Load a node's compiled ticks, where the launch asks for them; without them the plain ones do."""
    if node.setup.tick == "compiled" and node.kernel_module:
        from nodes.compiled.library import obtain
        from nodes.compiled.message_fields import NotCompilableError

        try:
            node.kernel = obtain(node.kernel_of(node.setup.parameters))
        except NotCompilableError as error:
            node.events.emit("tick", f"plain: {error}")
