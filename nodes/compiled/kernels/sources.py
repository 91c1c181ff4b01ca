"""Compiling the very functions that the nodes call: registered with numba as they are, without copies and without fastmath."""

from __future__ import annotations

from collections.abc import Callable
from ctypes import Structure
from typing import Any, TypeVar

import numba
import numpy as np
from numba.extending import register_jitable

Function = TypeVar("Function", bound=Callable[..., Any])


def kernel(function: Function) -> Function:
    """Let compiled functions call a plain function, which itself stays as it is."""
    # Only compiled code calls it: a way of calling it from C would be compiled for each.
    same: Function = register_jitable(no_cfunc_wrapper=True)(function)
    return same


def record_of(structure: type[Structure]) -> Any:
    """Give a struct of nodes/compiled/layout.py its type in kernels."""
    return numba.from_dtype(np.dtype(structure))
