"""Compiling the very functions that the nodes call: registered with numba as they are, without copies and without fastmath."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba
import numpy as np
from numba.extending import register_jitable

from nodes.compiled.rules import RULES

Function = TypeVar("Function", bound=Callable[..., Any])


def kernel(function: Function) -> Function:
    """Let compiled functions call a plain function, which itself stays as it is."""
    # Only compiled code calls it: a way of calling it from C would be compiled for each.
    same: Function = register_jitable(no_cfunc_wrapper=True)(function)
    return same


def register_rules() -> None:
    """Let compiled functions call every rule that was defined so far."""
    while RULES:
        kernel(RULES.pop())


def record_of(structure: type[Any]) -> Any:
    """Give a struct of nodes/compiled/layout.py its type in kernels."""
    return numba.from_dtype(np.dtype(structure))
