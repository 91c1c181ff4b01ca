"""What a node says of itself: its status at any time, and what it leaves behind at its end, where the launcher finds it."""

from __future__ import annotations

import os
import resource
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from messages.types import MAX_COUNT, NodeStatus
from nodes.base import realtime


def tick_of(node: Any) -> str:
    """Say which tick a node takes: ``compiled``, ``plain``, or nothing for one that takes none."""
    return "compiled" if node.kernel is not None else "plain" if node.publishes else ""


def status_of(node: Any) -> NodeStatus:
    """Describe a node now."""
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
        sent=node.sent + node.counters.mailed + sent,
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


def write_report(node: Any, figures: Mapping[str, Any] | None = None) -> None:
    """Write a node's last status and its report."""
    path = Path(node.setup.run_dir) / f"{node.setup.name}.report.json"
    draft = path.with_suffix(".draft")
    reported = node.report() if figures is None else figures
    status = msgspec.to_builtins(node.status())
    draft.write_bytes(
        msgspec.json.encode(
            {"status": status, "tick": tick_of(node), "ticks_compiled": node.ticks_compiled, **reported}
        )
    )
    draft.replace(path)
