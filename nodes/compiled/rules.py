"""Rules: plain functions on a state, called by the interpreter and compiled into ticks.

A rule registers by itself; nodes/compiled/kernels/sources.py passes all of them to numba. Nothing
here imports numba.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, TypeAlias, TypeVar

Function = TypeVar("Function", bound=Callable[..., Any])

RULES: Final[list[Callable[..., Any]]] = []  # all rules defined so far in this process

Made: TypeAlias = Callable[[Any], Any]  # compiles a function, or returns it as it is


def rule(function: Function) -> Function:
    """Register a function that compiled code may call; it stays a plain function."""
    RULES.append(function)
    return function
