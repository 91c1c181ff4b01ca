"""A kernel that takes no time to compile: it counts."""

from __future__ import annotations

from nodes.compiled.kernels.machine import compilable


@compilable
def ticks(address: int) -> int:
    """Give the number after a number."""
    return address + 1
