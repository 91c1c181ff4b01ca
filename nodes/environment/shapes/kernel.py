"""The environment's tick on shapes, compiled; on any other surface, too, that is set meanwhile."""

from __future__ import annotations

# Registers the geometry with numba.
import nodes.environment.shapes.compiled_geometry as _registered
from nodes.compiled.kernels.sources import kernel
from nodes.environment.kernel import make_ticks
from nodes.environment.meet import meet

del _registered

ticks = make_ticks(kernel(meet))  # answer device states with proxies until something is unusual
