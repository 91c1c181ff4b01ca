"""Memory by its address and the clock, for rules that are interpreted and compiled: here for the interpreter.

Where a rule looks at an array that somebody else holds, or at the clock, it calls a function of
this module; nodes/compiled/kernels/machine.py says what a kernel does in its place.
"""

from __future__ import annotations

import time
from ctypes import c_double, c_int64
from typing import Any


def reals_at(address: int, count: int) -> Any:
    """Look at an array of floats that somebody else holds."""
    return (c_double * count).from_address(address) if count else ()


def wholes_at(address: int, count: int) -> Any:
    """Look at an array of 64-bit integers that somebody else holds."""
    return (c_int64 * count).from_address(address) if count else ()


def shared_whole(address: int) -> int:
    """Load an integer that another process may be writing: before every later load."""
    return c_int64.from_address(address).value


def shared_real(address: int) -> float:
    """Load a float that another process may be writing: before every later load."""
    return c_double.from_address(address).value


def monotonic(s: object) -> float:
    """Read the monotonic clock [s]."""
    del s
    return time.monotonic()


def pairs_at(address: int, count: int) -> Any:
    """Look at an array of pairs of floats that somebody else holds."""
    return (c_double * 2 * count).from_address(address)
