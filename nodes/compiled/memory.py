"""Memory by address, and the clock, for rules: the interpreted versions.

A rule that reads an array of another owner, or the clock, calls a function of this module;
nodes/compiled/kernels/machine.py has the compiled versions.
"""

from __future__ import annotations

import time
from ctypes import c_double, c_int64
from typing import Any


def reals_at(address: int, count: int) -> Any:
    """Return a view of an array of floats."""
    return (c_double * count).from_address(address) if count else ()


def wholes_at(address: int, count: int) -> Any:
    """Return a view of an array of 64-bit integers."""
    return (c_int64 * count).from_address(address) if count else ()


def shared_whole(address: int) -> int:
    """Return an integer that another process may be writing, read before every later load."""
    return c_int64.from_address(address).value


def shared_real(address: int) -> float:
    """Return a float that another process may be writing, read before every later load."""
    return c_double.from_address(address).value


def monotonic(s: object) -> float:
    """Return the monotonic clock [s]."""
    del s
    return time.monotonic()


def pairs_at(address: int, count: int) -> Any:
    """Return a view of an array of pairs of floats."""
    return (c_double * 2 * count).from_address(address)
