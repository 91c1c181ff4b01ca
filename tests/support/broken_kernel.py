"""A kernel that cannot be compiled: a named function calls one that is not named."""

from __future__ import annotations

from nodes.compiled.kernels.machine import compilable
from nodes.compiled.kernels.sources import kernel


def unnamed(number: int) -> int:
    """Return a number."""
    return number


@kernel
def named(number: int) -> int:
    """Call the forgotten function."""
    return unnamed(number) + 1


@compilable
def ticks(address: int) -> int:
    """Return the next number."""
    return named(address)
