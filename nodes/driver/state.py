"""The state of a driver: one struct, which interpreted and compiled ticks read and write where it stands.

A new variable is a line here, and one where it is used. Whatever has no limit holds infinity. Rules are plain functions on the
struct, each in the module of what it rules; what they have to say is a code with numbers (`note`), which `nodes.driver.notes`
turns into words when the tick is done.
"""

from __future__ import annotations

from ctypes import Structure, c_double, c_int64
from typing import Any, Final

from nodes.compiled.layout import LOOP, named

BETWEEN: Final = 0
WAITING: Final = 1  # stands after its sample, for the force that answers it; 0: before it
IDLE, RAMP, ACTIVE, DAMPING, NOTHING, FAULT, STOPPED = range(7)
SAFETY: Final = ("waiting", "ramp", "active", "damping", "zero", "fault", "stopped")
"""What the safety does with forces: its states, and their names in messages."""

REFUSED: Final = ("future", "replayed", "stale", "not_finite")
LIMITED: Final = ("peak", "slew", "continuous")

BINS: Final = 50_000
RECENT: Final = 512  # newest response times that are kept as they are, for the status line
PEAKS: Final = 64  # room for the moments at which the force came to its limit

NOTES: Final = 32
NOTE: Final = 8  # numbers of a note on what the rules do in a tick: code, tick, change of state, and five more
_VECTORS = (
    # the position just read, and the message just taken
    *("place", "got"),
    # what is asked for on its way through ramp, guard and limits; what was decided last, what is on the device, what comes next
    *("wanted", "force", "handed", "following"),
    # of the newest tick: how far the force has changed on each axis, and its mean up to a place in the tick
    *("slewed", "mean"),
    # motion: newest sample, the one before, mean force since the newest and between the two, velocity
    *("position", "before", "acting", "acted", "velocity"),
    # where a simulated hand pulls to, and the damper of a driver that has stopped
    *("target", "brake"),
    *("guard_energy", "guard_step"),
)

_NUMBERS = (
    # the tick: when tick 0 was, when its sample was published, when a message came
    *("epoch", "sampled", "arrival", "late_answer_at", "lateness", "response", "delay"),
    # where in the tick the mean force stands, and where the force first changed; after how many ticks the device lets go
    *("split", "changed_at", "device_hold_ticks"),
    # safety
    *("peak", "slew", "damping", "away_from", "regained", "reach"),
    # the motor's heat: continuous force, share kept per tick and over a gap, mean square, largest square of this tick
    *("continuous", "heat_keep", "heat_reserve", "heat", "heat_largest"),
    # motion
    *("energy", "highest", "at", "at_before", "line_part"),
    # guard
    *("guard_stiffness", "guard_rate", "guard_allowance", "guard_highest", "longest"),
)

_COUNTERS = (
    # the device: its two calls, and what they are called with
    *("device_read", "device_write", "device_context", "device_room"),
    # other threads ask compiled ticks to come back
    *("attention", "phase", "next_tick", "virtual", "axes", "fd", "poll"),
    # the position was read by somebody else; what somebody else made of a message, plus 1; a call of the device failed
    *("place_given", "given", "failed", "got_seq", "late_answer", "heard", "patient", "has_following", "written"),
    # ticks in a row without their answer
    "unanswered",
    *("age", "oldest_age", "missed", "overruns", "taken", "states_sent", "asked"),
    # safety
    *("safety", "force_seq", "since", "limited_at", "max_age", "watchdog", "damping_ticks", "start_ticks", "recovery_ticks"),
    *("ramp_ticks", "ramp_seq", "unlimited", "bounded"),
    # swings
    *("stop_after", "peaked", "peaks_count", "stopped_at"),
    # motion: where the newest samples are, and forces under way
    *("begun", "elapsed", "covered", "samples", "places", "places_count", "lines", "line_length"),
    # guard
    *("guard_on", "guard_bounded", "lowered", "raised"),
    # response times
    *("recent_at", "counted", "bins"),
    # what there is to say
    "notes_count",
)


class DriverState(Structure):
    """All that a driver keeps from tick to tick."""

    _fields_ = [
        *LOOP,
        *named(c_double * 3, *_VECTORS),
        *named(c_double, *_NUMBERS),
        *named(c_int64, *_COUNTERS),
        ("axis", c_int64 * 3),
        ("sides", c_int64 * 3),
        ("workspace", c_double * 6),
        # forces from outside (nodes/driver/external.py): two places, up to which tick each holds, and which one counts
        ("external", c_double * 6),
        ("external_until", c_int64 * 2),
        ("external_at", c_int64),
        ("entered", c_int64 * len(SAFETY)),
        ("refused_for", c_int64 * len(REFUSED)),
        ("limited_by", c_int64 * len(LIMITED)),
        ("peaks", c_double * (2 * PEAKS)),
        ("recent", c_double * RECENT),
        ("notes", c_double * (NOTE * NOTES)),
        ("texts", c_int64 * len(SAFETY)),
        ("text_sizes", c_int64 * len(SAFETY)),
    ]


def note(
    s: Any, code: int, seq: int, change: int, a: float = 0.0, b: float = 0.0, c: float = 0.0, d: float = 0.0, e: float = 0.0
) -> None:
    """Take down what is to be said when the tick is done."""
    if s.notes_count >= NOTES:
        # No tick has so many, and each ends with them told; compiled code would write beyond the end.
        return
    at = NOTE * s.notes_count
    s.notes[at], s.notes[at + 1], s.notes[at + 2] = float(code), float(seq), float(change)
    s.notes[at + 3], s.notes[at + 4], s.notes[at + 5], s.notes[at + 6], s.notes[at + 7] = a, b, c, d, e
    s.notes_count += 1


def seldom(count: int) -> bool:
    """Whether the n-th of many alike is one that is said: at powers of two."""
    return count & (count - 1) == 0
