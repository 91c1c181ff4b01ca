"""Following the ticks of another node, as nodes/base/follow.py does in the usual case."""

from __future__ import annotations

from messages.types import MAX_COUNT
from nodes.compiled.kernels.hop import has_message, monotonic
from nodes.compiled.kernels.machine import compilable
from nodes.compiled.layout import LoopState

_MAX_COUNT = MAX_COUNT


@compilable
def in_order(s: LoopState, seq: int) -> bool:
    """Return whether a message is the next one, or one after skipped ticks."""
    if seq <= s.seq or seq >= s.until:
        return False
    return bool(seq == s.seq + 1 or s.seq >= 0)


@compilable
def count_gap(s: LoopState, missing: int) -> None:
    """Count missing ticks, up to the largest count of a status."""
    s.gaps = min(s.gaps + missing, _MAX_COUNT)


@compilable
def overtaken(s: LoopState, stamp: float) -> bool:
    """Return whether a message is older than a period and a newer one waits.

    The node then continues with the newest.
    """
    if s.realtime == 0 or (
        s.skipping == 0 and monotonic(s) + s.clock_offset - stamp <= s.period
    ):
        return False
    s.skipping = 1 if has_message(s, s.inbox) else 0
    if s.skipping != 0:
        s.skipped += 1
        # if the newer one is unusual, the plain tick judges both
        s.payload, s.spare = s.spare, s.payload
        s.spare_size = s.payload_size
    return bool(s.skipping != 0)
