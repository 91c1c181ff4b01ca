"""Following the ticks of another node, as nodes/base/follow.py does when nothing is out of the ordinary."""

from __future__ import annotations

from typing import Any

from nodes.tick.kernels.hop import monotonic
from nodes.tick.kernels.machine import compilable


@compilable
def in_order(s: Any, seq: int, stamp: float) -> bool:
    """Whether a message is the next one, in time, and not to be left to the plain tick.

    After ticks that the driver left out the next one is a later one; who remembers what was before may have to bridge them.
    """
    if seq <= s.seq or seq >= s.until or (seq > s.seq + 1 and (s.seq < 0 or s.may_skip == 0)):
        return False
    return bool(s.realtime == 0 or monotonic(s) + s.clock_offset - stamp <= s.period)
