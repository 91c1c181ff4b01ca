"""State of a coupling: one struct that interpreted and compiled ticks update in place.

Laws are stored in slots, `SLOTS` for each axis of the scene: the active one, then those that fade
out.
"""

from __future__ import annotations

from typing import Annotated, Final, TypeAlias

from messages.types import Force
from nodes.compiled.layout import LoopState, Vector3, struct
from nodes.compiled.published import published

# laws that may fade out at once, to limit a tick's work; faster changes are merged
LEAVING: Final = 8
SLOTS: Final = 1 + LEAVING


Slots: TypeAlias = Annotated[list[int], 3 * SLOTS]


@struct
class CouplingState(LoopState):
    """State that a coupling keeps between ticks."""

    raw: int  # 1 if the history continues outside contact (`history: position`)
    clamp: int  # 1 if a force never pulls
    revision: int  # receipts published so far
    delay: float  # measured delay of the loop [ticks]

    # The answer
    stamp: float  # its time [s]
    force: Vector3  # [N]
    normal: Vector3  # of the surface that is touched; 0 for none
    credit: float  # energy that a partner has put in so far [J]

    # Axes of the scene, and per axis the history
    axes: int  # number of axes
    axis: Annotated[list[int], 3]  # index of each
    length: int  # values of a history
    # address of a history, which stores its values twice
    history: Annotated[list[int], 3]
    head: Annotated[list[int], 3]  # index of the newest value
    pushes: Annotated[list[int], 3]  # values pushed so far

    # Laws, slot by slot
    taps: Slots  # address
    taps_count: Slots
    sections: Slots  # address of the coefficients
    sections_count: Slots
    sections_state: Slots  # address
    weight: Annotated[list[float], 3 * SLOTS]  # weight of the leaving laws [1]
    still: Annotated[list[float], 3 * SLOTS]  # stiffness of each at rest, H(1) [N/m]

    # The present cross-fade
    fade_ramp: int  # length [ticks]; 0 for none
    fade_done: int  # ticks done
    leaving: int  # number of leaving laws

    # State that a tick overwrites, to undo it
    undo: int  # address of the sections' states
    undo_count: int
    oldest: Vector3  # value of a history that the newest one replaced [m]

    # Axes of the history
    turning: int  # 0: the world's; 1: turning with the surface; 2: turned, but no longer turning
    turned: Annotated[list[float], 9]  # the axes, by rows
    upright: Vector3  # normal at their last turn
    turned_before: Annotated[list[float], 12]  # both before the tick

    # Jumps without motion
    rebased: int  # tick of the latest one (Proxy.rebased)
    jumps: int  # 1 if changed conventions make the next tick a jump

    # The easing after a jump
    ease_ramp: int  # length [ticks]; 0 for none
    ease_usual: int  # the coupling's own length [ticks]
    ease_done: int  # ticks done
    felt: Vector3  # force of the last tick [N]
    ease_from: Vector3  # force at the jump [N]
    ease_offset: Vector3  # force at the jump minus the requested force [N]
    # largest force of the driver along an axis [N]; beyond it nothing is felt; 0: unknown
    ease_peak: float

    # The force field (nodes/coupling/force_fields.py)
    field: int  # 1 if there is one
    field_gain: Annotated[list[float], 9]  # M/T, by rows [N/m]
    field_force: Vector3  # F₀ [N]
    field_at: Vector3  # position of the last tick [m]
    field_way: Vector3  # way of the last tick [m]
    field_due: int  # number of that tick's deflection; 0: none, or a jump


PUBLISHED: Final = published(Force, CouplingState)
"""Where the fields of a force stand here: under the same names."""
