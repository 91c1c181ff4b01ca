"""Registration of the nodes' own functions with numba: no copies, no fastmath."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba
import numpy as np
from numba.extending import register_jitable

from nodes.compiled.rules import RULES

Function = TypeVar("Function", bound=Callable[..., Any])


def kernel(function: Function) -> Function:
    """Make a plain function callable from compiled ones; it stays unchanged."""
    # without a C wrapper, which would be compiled for each: only compiled code calls it
    same: Function = register_jitable(no_cfunc_wrapper=True)(function)
    return same


def register_rules() -> None:
    """Make all rules defined so far callable from compiled functions."""
    while RULES:
        kernel(RULES.pop())


def record_of(structure: type[Any]) -> Any:
    """Return the type in kernels of a struct of nodes/compiled/layout.py."""
    return numba.from_dtype(np.dtype(structure))
