"""The state of an environment: one struct, which interpreted and compiled ticks read and write where it stands."""

from __future__ import annotations

from ctypes import Structure, c_double, c_int64
from typing import Final

from nodes.compiled.layout import LOOP, named
from nodes.environment.spent import BINS

FREE, PLANE, ANCHOR, SHAPES = range(4)  # kinds of surface that are numbers
UNKNOWN: Final = -1  # a surface that only its own code knows
MET: Final = 8  # numbers of an answer: proxy (3) [m], outward normal (3), signed distance [m], 1 where the proxy jumped
JUMPED: Final = 7


class EnvironmentState(Structure):
    """All that an environment keeps from tick to tick."""

    _fields_ = [
        *LOOP,
        # the kind of the surface, its numbers, what its proxy remembers, and the answer of the last tick
        *named(c_int64, "kind", "table", "table_count", "memory", "memory_count"),
        ("met", c_double * MET),
        # the tick of the environment's own latest jump and the length of its easing, 0 for the coupling's own [ticks]; the
        # latest jump that the driver told
        *named(c_int64, "rebased", "ease", "driver_rebased"),
        # ticks by the time that they took (nodes/environment/spent.py)
        ("spent", c_int64 * BINS),
    ]
