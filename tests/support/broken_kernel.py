"""A kernel that cannot be compiled: it calls a function that it does not name, from a function that it does."""

from __future__ import annotations

from nodes.compiled.kernels.machine import compilable
from nodes.compiled.kernels.sources import kernel


def unnamed(number: int) -> int:
    """Give a number."""
    return number


@kernel
def named(number: int) -> int:
    """Call what was forgotten."""
    return unnamed(number) + 1


@compilable
def ticks(address: int) -> int:
    """Give the number after a number."""
    return named(address)
