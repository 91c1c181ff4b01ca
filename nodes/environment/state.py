"""The state of an environment: one struct, which interpreted and compiled ticks read and write where it stands."""

from __future__ import annotations

from typing import Annotated, Final

from nodes.compiled.layout import LoopState, struct
from nodes.environment.spent import BINS

FREE, PLANE, ANCHOR, SHAPES = range(4)  # kinds of surface that are numbers
UNKNOWN: Final = -1  # a surface that only its own code knows
MET: Final = 9
"""Numbers of an answer: proxy (3) [m], outward normal (3), signed distance [m], 1 where the proxy jumped, solids not felt."""

JUMPED, INSIDE = 7, 8


@struct
class EnvironmentState(LoopState):
    """Everything an environment keeps from tick to tick."""

    kind: int  # FREE, PLANE, ANCHOR, SHAPES or UNKNOWN
    table: int  # address of the surface's numbers
    table_count: int
    memory: int  # address of what its proxy remembers
    memory_count: int
    met: Annotated[list[float], MET]  # answer of the last tick
    rebased: int  # tick of the environment's own latest jump
    ease: int  # length of its easing [ticks]; 0 for the coupling's own
    driver_rebased: int  # latest jump that the driver sent
    # solids that the last event said are not felt, because the tool began inside of them
    inside: int
    # ticks by the time that they took (nodes/environment/spent.py)
    spent: Annotated[list[int], BINS]
