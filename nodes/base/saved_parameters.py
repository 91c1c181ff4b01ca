"""Parameters survive their process: a restarted node keeps its live parameters.

They are written outside the loop, before a change is answered, into the directory of the run, which
is removed with the run.
"""

from pathlib import Path
from typing import Any

import msgspec

from nodes.base.node import Node
from nodes.base.status_report import write_whole
from nodes.parameters.store import ParameterError, convert


class Kept(msgspec.Struct, frozen=True, kw_only=True):
    """Content of the file: parameters, their tick, and the last save of a watched file."""

    seq: int
    parameters: dict[str, Any]
    watched: tuple[int, int, int] | None = None


def _path(node: Node) -> Path:
    return Path(node.setup.run_dir) / f"{node.setup.name}.kept"


def save_parameters(node: Node) -> None:
    """Save the node's parameters if they changed since the last save (control thread)."""
    # In this order: a scheduled change in between is then repeated, not lost.
    seq = node.counted().seq
    current = node.store.current
    if current is node.saved_parameters or not node.setup.run_dir:
        return
    node.saved_parameters = current
    kept = Kept(seq=seq, parameters=msgspec.to_builtins(current), watched=node.watched)
    write_whole(_path(node), kept)


def resume(node: Node) -> None:
    """Continue with the parameters of a predecessor, if they were changed."""
    path = _path(node)
    if not node.setup.run_dir or not path.exists():
        return
    try:
        kept = msgspec.json.decode(path.read_bytes(), type=Kept)
        node.store.accept(convert(kept.parameters, node.Parameters, node.setup.name))
    except (msgspec.DecodeError, ParameterError) as error:
        node.events.log(
            f"its saved parameters cannot be used: {error}; using the launch file's"
        )
        return
    node.saved_parameters = node.store.current
    node.resumed_at = kept.seq
    node.watched = kept.watched
    node.events.emit_each(
        "resumed",
        f"continues with its parameters of tick {kept.seq}",
        {"tick": kept.seq},
    )
