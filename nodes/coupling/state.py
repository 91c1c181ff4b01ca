"""The state of a coupling: one struct, which interpreted and compiled ticks read and write where it stands.

Laws stand in slots, `SLOTS` for each axis of the scene: the one that renders, then those that fade
out.
"""

from __future__ import annotations

from typing import Annotated, Final, TypeAlias

from nodes.compiled.layout import LoopState, Vector3, struct

# laws that may fade out together, to bound a tick's work: of faster swaps some are joined
LEAVING: Final = 8
SLOTS: Final = 1 + LEAVING


Slots: TypeAlias = Annotated[list[int], 3 * SLOTS]


@struct
class CouplingState(LoopState):
    """Everything a coupling keeps from tick to tick."""

    raw: int  # 1 where the history goes on outside contact (`history: position`)
    clamp: int  # 1 where a force never pulls
    revision: int  # receipts given so far
    delay: float  # delay of the loop, as measured [ticks]

    # Axes of the scene, and per axis the history
    axes: int  # how many
    axis: Annotated[list[int], 3]  # which
    length: int  # values of a history
    history: Annotated[list[int], 3]  # address of a history, its values twice
    head: Annotated[list[int], 3]  # index of the newest value
    pushes: Annotated[list[int], 3]  # values pushed so far

    # Laws, slot by slot
    taps: Slots  # address
    taps_count: Slots
    sections: Slots  # address of the coefficients
    sections_count: Slots
    sections_state: Slots  # address
    weight: Annotated[list[float], 3 * SLOTS]  # of the laws that leave [1]

    # The cross-fade under way
    fade_ramp: int  # its length [ticks]; 0 for none
    fade_done: int  # how much of it is done [ticks]
    leaving: int  # laws that leave

    # What a tick overwrites, for one that must be undone
    undo: int  # address of the sections' states
    undo_count: int
    oldest: Vector3  # value of a history that the newest one replaced [m]

    # Axes of the history
    turning: int  # 0 the world's, 1 turning with the surface, 2 turned no more
    turned: Annotated[list[float], 9]  # which ones, in rows
    upright: Vector3  # normal that they turned to last
    turned_before: Annotated[list[float], 12]  # both as they were before the tick

    # Jumps that no motion made
    rebased: int  # tick of the latest one (Proxy.rebased)
    jumps: int  # 1 where a change of conventions makes the next tick one

    # The easing after a jump
    ease_ramp: int  # its length [ticks]; 0 for none
    ease_usual: int  # the coupling's own length [ticks]
    ease_done: int  # how much of it is done [ticks]
    felt: Vector3  # force of the last tick [N]
    ease_from: Vector3  # force at the jump [N]
    ease_offset: Vector3  # how much that was more than was asked [N]
    # largest force of the driver along an axis [N], beyond which nothing is felt; 0 for unknown
    ease_peak: float
