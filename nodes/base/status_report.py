"""Status of a node at any time, and its report at the end, which the launcher reads."""

import os
import resource
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, Protocol

import msgspec

from messages.types import MAX_COUNT, NodeStatus
from nodes.base import realtime
from nodes.base.events import Clock, Events
from nodes.base.setup import Setup


class Counted(NamedTuple):
    """Progress of a node: tick, ticks handled, ticks missing, messages skipped for newer ones."""

    seq: int
    ticks: int
    gaps: int
    skipped: int


class Counters:
    """The same for a node without compiled ticks; -1 is the tick before the first."""

    def __init__(self) -> None:
        self.seq = self.answered = -1
        self.ticks = self.gaps = self.skipped = self.outgoing_sent = 0


class ReportedNode(Protocol):
    """A node as its status and its report see it."""

    answers: ClassVar[bool]
    publishes: ClassVar[tuple[str, ...]]
    setup: Setup
    clock: Clock
    events: Events
    counters: Any  # `Counters`, or a struct with the same fields
    kernel: Callable[[int], int] | None
    state: str
    stop_reason: str
    sent: int
    received: int
    ticks_compiled: int

    def counted(self) -> Counted:
        """Return its tick counts."""

    def status(self) -> NodeStatus:
        """Return its status."""

    def report(self) -> dict[str, Any]:
        """Return its own figures."""


def status_of(node: ReportedNode) -> NodeStatus:
    """Return the status of a node."""
    seq, ticks, gaps, skipped = node.counted()
    sent, received = (ticks, ticks + skipped) if node.answers else (0, 0)
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return NodeStatus(
        seq=seq,
        stamp=node.clock.now(),
        node=node.setup.name,
        kind=node.setup.kind,
        state=node.state,
        pid=os.getpid(),
        ticks=ticks,
        sent=node.sent + node.counters.outgoing_sent + sent,
        received=node.received + received,
        refused=node.events.refused,
        skipped=skipped,
        gaps=min(gaps, MAX_COUNT),
        reason=node.stop_reason,
        memory=float(realtime.memory_bytes()),
        cpu=usage.ru_utime + usage.ru_stime,
        denied=node.events.denied,
        clock_offset=node.clock.offset,
        clock_error=node.clock.error,
    )


def report_of(node: ReportedNode, figures: Mapping[str, Any]) -> dict[str, Any]:
    """Return a node's report, including its last status."""
    status = msgspec.to_builtins(node.status())
    # empty for a node without ticks
    tick = "compiled" if node.kernel is not None else "plain" if node.publishes else ""
    return {
        "status": status,
        "tick": tick,
        "ticks_compiled": node.ticks_compiled,
        **figures,
    }


def write_whole(path: Path, content: Any) -> None:
    """Write JSON atomically: readers find all of it, or the previous content."""
    draft = path.with_name(f"{path.name}.draft")
    draft.write_bytes(msgspec.json.encode(content))
    draft.replace(path)


def write_report(node: ReportedNode, figures: Mapping[str, Any] | None = None) -> None:
    """Write a node's last status and its report."""
    report = report_of(node, node.report() if figures is None else figures)
    write_whole(Path(node.setup.run_dir) / f"{node.setup.name}.report.json", report)
