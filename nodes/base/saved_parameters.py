"""Parameters outlive their process: a node that is started again goes on with those that it had, not the launch file's.

They are written off the hot path, before a change is answered, into the directory of the run, with
which they end.
"""

from pathlib import Path
from typing import Any

import msgspec

from nodes.base.node import Node
from nodes.base.status_report import write_whole
from nodes.parameters.store import ParameterError, convert


class Kept(msgspec.Struct, frozen=True, kw_only=True):
    """What the file holds: a node's parameters, the tick up to which they are true, and which save of a watched file is in."""

    seq: int
    parameters: dict[str, Any]
    watched: tuple[int, int, int] | None = None


def _path(node: Node) -> Path:
    return Path(node.setup.run_dir) / f"{node.setup.name}.kept"


def keep(node: Node) -> None:
    """Write the node's parameters down, if they are no longer those that were written last (control thread)."""
    # In this order: what a scheduled swap changes in between is then done once more, and not left
    # out.
    seq, current = node.counted().seq, node.store.current
    if current is node.saved_parameters or not node.setup.run_dir:
        return
    node.saved_parameters = current
    kept = Kept(seq=seq, parameters=msgspec.to_builtins(current), watched=node.watched)
    write_whole(_path(node), kept)


def resume(node: Node) -> None:
    """Go on with what a predecessor of this node had, if there was one and it was changed."""
    path = _path(node)
    if not node.setup.run_dir or not path.exists():
        return
    try:
        kept = msgspec.json.decode(path.read_bytes(), type=Kept)
        node.store.accept(convert(kept.parameters, node.Parameters, node.setup.name))
    except (msgspec.DecodeError, ParameterError) as error:
        node.events.log(
            f"what it had before it was started again cannot be used: {error}; the launch file's"
            " parameters hold"
        )
        return
    node.saved_parameters, node.resumed_at, node.watched = (
        node.store.current,
        kept.seq,
        kept.watched,
    )
    node.events.emit_each(
        "resumed", f"goes on with the parameters that it had at tick {kept.seq}", {"tick": kept.seq}
    )
