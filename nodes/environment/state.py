"""State of an environment: one struct that interpreted and compiled ticks update in place."""

from __future__ import annotations

from typing import Annotated, Final

from messages.types import Proxy
from nodes.compiled.layout import LoopState, Vector3, struct
from nodes.compiled.published import published
from nodes.compiled.rules import rule
from nodes.environment.spent import BINS

FREE, PLANE, ANCHOR, SHAPES = range(4)  # kinds of surface that are numbers
UNKNOWN: Final = -1  # the surface has no numbers; only its own code can meet it
MET: Final = 11
"""Floats of an answer, in this order:

proxy (3) [m], outward normal (3), signed distance [m], 1 after a jump, number of solids not felt,
factors of the law's stiffness and damping.
"""

PROXY, NORMAL, DISTANCE, JUMPED, INSIDE, STIFFNESS, DAMPING = 0, 3, 6, 7, 8, 9, 10


@struct
class EnvironmentState(LoopState):
    """State that an environment keeps between ticks."""

    kind: int  # FREE, PLANE, ANCHOR, SHAPES or UNKNOWN
    table: int  # address of the surface's table
    table_count: int
    memory: int  # address of the proxy's memory
    memory_count: int
    met: Annotated[list[float], MET]  # proxy, normal and distance of the last tick
    contact: int  # 1 if the surface is touched
    stamp: float  # time of the answer [s]
    position: Vector3  # position that it answers [m]
    delay: float  # delay of the loop as the driver measured it [ticks]
    told_rebased: int  # tick of the latest jump, whoever made it
    told_ease: int  # ticks over which the coupling eases that one
    credit: float  # 0: only a partner's device puts energy in
    compliance: float  # 0: only a body yields to the force of the same tick
    rebased: int  # tick of the environment's own latest jump of the proxy
    ease: int  # ticks over which the coupling eases that jump; 0: the coupling's own setting
    driver_rebased: int  # tick of the latest jump announced by the driver
    # solids reported as not felt, because the tool began inside them
    inside: int
    # histogram of tick durations (nodes/environment/spent.py)
    spent: Annotated[list[int], BINS]


PUBLISHED: Final = published(
    Proxy,
    EnvironmentState,
    proxy=("met", PROXY),
    normal=("met", NORMAL),
    distance=("met", DISTANCE),
    rebased="told_rebased",
    ease="told_ease",
    stiffness=("met", STIFFNESS),
    damping=("met", DAMPING),
)
"""Where the fields of a proxy stand here; whatever is not named has the same name."""


@rule
def tell_jump(s: EnvironmentState) -> None:
    """Choose the jump that the answer names: the later one of the driver's and the node's own."""
    s.told_rebased = max(s.rebased, s.driver_rebased)
    s.told_ease = s.ease if s.rebased >= s.driver_rebased else 0
