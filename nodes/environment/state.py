"""State of an environment: one struct that interpreted and compiled ticks update in place."""

from __future__ import annotations

from typing import Annotated, Final

from nodes.compiled.layout import LoopState, struct
from nodes.environment.spent import BINS

FREE, PLANE, ANCHOR, SHAPES = range(4)  # kinds of surface that are numbers
UNKNOWN: Final = -1  # the surface has no numbers; only its own code can meet it
MET: Final = 9
"""Floats of an answer, in this order:

proxy (3) [m], outward normal (3), signed distance [m], 1 after a jump, number of solids not felt.
"""

JUMPED, INSIDE = 7, 8


@struct
class EnvironmentState(LoopState):
    """State that an environment keeps between ticks."""

    kind: int  # FREE, PLANE, ANCHOR, SHAPES or UNKNOWN
    table: int  # address of the surface's table
    table_count: int
    memory: int  # address of the proxy's memory
    memory_count: int
    met: Annotated[list[float], MET]  # answer of the last tick
    rebased: int  # tick of the environment's own latest jump of the proxy
    ease: int  # ticks over which the coupling eases that jump; 0: the coupling's own setting
    driver_rebased: int  # tick of the latest jump announced by the driver
    # solids reported as not felt, because the tool began inside them
    inside: int
    # histogram of tick durations (nodes/environment/spent.py)
    spent: Annotated[list[int], BINS]
