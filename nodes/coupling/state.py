"""The state of a coupling: one struct, which interpreted and compiled ticks read and write where it stands.

Laws stand in slots, `SLOTS` for each axis of the scene: the one that renders, then those that fade out.
"""

from __future__ import annotations

from ctypes import Structure, c_double, c_int64
from typing import Final

from nodes.compiled.layout import LOOP, named

LEAVING: Final = 8  # laws that may fade out together, to bound a tick's work: of faster swaps some are joined
SLOTS: Final = 1 + LEAVING


class CouplingState(Structure):
    """All that a coupling keeps from tick to tick."""

    _fields_ = [
        *LOOP,
        # contact conventions, receipts given so far, delay of the loop as measured [ticks]
        *named(c_int64, "raw", "clamp", "revision"),
        ("delay", c_double),
        # axes of the scene, and per axis the history: where it is, index of the newest value, values pushed so far
        ("axes", c_int64),
        ("axis", c_int64 * 3),
        ("length", c_int64),
        *named(c_int64 * 3, "history", "head", "pushes"),
        # laws, slot by slot: where their numbers are and how many, and the weight of those that leave
        *named(c_int64 * (3 * SLOTS), "taps", "taps_count", "sections", "sections_count", "sections_state"),
        ("weight", c_double * (3 * SLOTS)),
        # the cross-fade under way, 0 ticks for none: its length, how much of it is done, how many laws leave
        *named(c_int64, "fade_ramp", "fade_done", "leaving"),
        # what a tick overwrites, for one that must be undone
        *named(c_int64, "undo", "undo_count"),
        ("oldest", c_double * 3),
        # axes of the history: 0 the world's, 1 turning with the surface, 2 turned no more; which ones they are (rows), the
        # normal that they turned to last, and both as they were before the tick
        ("turning", c_int64),
        ("turned", c_double * 9),
        ("upright", c_double * 3),
        ("turned_before", c_double * 12),
        # the latest jump that no motion made (Proxy.rebased), and whether a change of conventions makes the next tick one
        *named(c_int64, "rebased", "jumps"),
        # the easing after it, 0 ticks for none: its length, the usual one, how much of it is done; the force of the last tick,
        # that at the jump, and how much that was more than was asked [N]
        *named(c_int64, "ease_ramp", "ease_usual", "ease_done"),
        *named(c_double * 3, "felt", "ease_from", "ease_offset"),
    ]
