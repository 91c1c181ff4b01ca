"""Parameters of a file that a node watches: each save is applied, or refused as a whole."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from nodes.base.node import Node
from nodes.parameters.store import ParameterError
from nodes.parameters.yaml_io import WatchedFile

# limits of the change log: names listed, characters per value
LISTED_CHANGES: Final = 4
SHOWN_CHARACTERS: Final = 60

ApplyChange = Callable[[Callable[[], Any]], dict[str, Any]]
"""Applies the parameters of a function between two ticks; returns the receipt."""


class WatchedParameters:
    """The watched file of one node (control thread)."""

    def __init__(self, node: Node, change: ApplyChange) -> None:
        self._node, self._change = node, change
        self._file = WatchedFile(node.setup.watch, node.watched)

    def poll(self) -> None:
        """Apply the file if it was saved since the last call; report changes or a refusal."""
        node, watched = self._node, self._file
        where = ""  # errors of the file itself name it already
        try:
            values = watched.poll()
            where = f"{watched.path}: "
            if values is not None and node.store.merged(values) != node.store.current:
                receipt = self._change(lambda: node.store.merged(values))
                node.events.log(f"applied {watched.path}: {_change_log(receipt)}")
        except Exception as error:  # noqa: BLE001  # as for requests: refuse, report, keep serving
            known = isinstance(error, ParameterError)
            reason = (
                f"{where}{error}"
                if known
                else f"{watched.path}: {type(error).__name__}: {error}"
            )
            node.events.emit_each(
                "refused", f"{reason}; the running parameters are untouched"
            )
        finally:
            node.watched = watched.applied


def _change_log(receipt: dict[str, Any]) -> str:
    """Return the changes of a file in one line; the receipt itself is published and recorded."""
    changed = [
        f"{path} {str(old)[:SHOWN_CHARACTERS]} → {str(new)[:SHOWN_CHARACTERS]}"
        for path, (old, new) in receipt["changed"].items()
    ]
    more = (
        f", {len(changed) - LISTED_CHANGES} more"
        if len(changed) > LISTED_CHANGES
        else ""
    )
    return f"{', '.join(changed[:LISTED_CHANGES])}{more} from tick {receipt['seq']} on"
