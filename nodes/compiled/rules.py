"""Rules: plain functions on a state, called by the interpreter and compiled into ticks.

A rule registers by itself; nodes/compiled/kernels/sources.py passes all of them to numba. Nothing
here imports numba.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, TypeVar

Function = TypeVar("Function", bound=Callable[..., Any])

RULES: Final[list[Callable[..., Any]]] = []  # all rules defined so far in this process


def rule(function: Function) -> Function:
    """Register a function that compiled code may call; it stays a plain function."""
    RULES.append(function)
    return function
