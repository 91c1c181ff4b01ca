"""Registration of the interpreted geometry with numba, so that both give the same bits."""

from __future__ import annotations

from inspect import isfunction

from nodes.compiled.kernels.sources import kernel
from nodes.environment.shapes import (
    beginning,
    carry,
    convex,
    patch,
    planes,
    proxy,
    regions,
    surface_friction,
    tree,
    triangle,
)

for _module in (
    convex,
    triangle,
    tree,
    beginning,
    planes,
    patch,
    surface_friction,
    regions,
    carry,
    proxy,
):
    for _function in vars(_module).values():
        if isfunction(_function) and _function.__module__ == _module.__name__:
            kernel(_function)
