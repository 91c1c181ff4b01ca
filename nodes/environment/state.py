"""The state of an environment: one struct, which interpreted and compiled ticks read and write where it stands."""

from __future__ import annotations

from ctypes import Structure, c_double, c_int64
from typing import Final

from nodes.compiled.layout import LOOP
from nodes.environment.spent import BINS

FREE: Final = 0
PLANE: Final = 1
ANCHOR: Final = 2
SHAPES: Final = 3
"""Kinds of surface that are numbers."""

UNKNOWN: Final = -1
"""A surface that only its own code knows."""

MET: Final = 7
"""Numbers of an answer: proxy (3) [m], outward normal (3), signed distance [m]."""


class EnvironmentState(Structure):
    """All that an environment keeps from tick to tick."""

    _fields_ = [
        *LOOP,
        # the kind of the surface, its numbers, what its proxy remembers, and the answer of the last tick
        ("kind", c_int64),
        ("table", c_int64),
        ("table_count", c_int64),
        ("memory", c_int64),
        ("memory_count", c_int64),
        ("met", c_double * MET),
        # ticks by the time that they took (nodes/environment/spent.py)
        ("spent", c_int64 * BINS),
    ]
