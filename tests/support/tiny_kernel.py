"""A kernel that compiles quickly: it counts."""

from __future__ import annotations

from nodes.compiled.kernels.machine import compilable


@compilable
def ticks(address: int) -> int:
    """Return the next number."""
    return address + 1
