"""Following the ticks of another node, as nodes/base/follow.py does when nothing is out of the ordinary."""

from __future__ import annotations

from typing import Any

from nodes.tick.kernels.hop import monotonic
from nodes.tick.kernels.machine import compilable


@compilable
def in_order(s: Any, seq: int, stamp: float) -> bool:
    """Whether a message is the next one, in time, and not to be left to the plain tick."""
    if seq != s.seq + 1 or seq >= s.until:
        return False
    return bool(s.realtime == 0 or monotonic(s) + s.clock_offset - stamp <= s.period)
