"""Compiled tick of the environment on shapes; it also meets every other surface."""

from __future__ import annotations

# registers the geometry with numba
import nodes.environment.shapes.compiled_geometry as _registered
from nodes.compiled.kernels.sources import kernel
from nodes.environment.kernel import make_ticks
from nodes.environment.meet import meet

del _registered

ticks = make_ticks(kernel(meet))  # answer device states until the plain tick is needed
