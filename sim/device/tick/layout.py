"""What the sim driver and its kernel share."""

from __future__ import annotations

from ctypes import Structure, c_double, c_int64
from typing import Final

from nodes.tick.layout import LOOP

BETWEEN: Final = 0
WAITING: Final = 1
"""Where in a tick the kernel stopped: before its sample, or after it, waiting for the force that answers it."""

PENDING: Final = 2048
"""Room for forces on their way to the device; a delay is at most 1000 ticks."""


class DriverState(Structure):
    """The sim driver's side of the border."""

    _fields_ = [
        *LOOP,
        ("attention", c_int64),
        ("phase", c_int64),
        # the driver: see nodes/driver/node.py
        ("next_tick", c_int64),
        ("axes", c_int64),
        ("axis", c_int64 * 3),
        ("epoch", c_double),
        ("fd", c_int64),
        ("poll", c_int64),
        ("workspace", c_double * 6),
        ("reach", c_double),
        ("sampled", c_double),
        ("lateness", c_double),
        ("response", c_double),
        ("delay", c_double),
        ("age", c_int64),
        ("oldest_age", c_int64),
        ("missed", c_int64),
        ("overruns", c_int64),
        ("has_following", c_int64),
        ("following", c_double * 3),
        ("handed", c_double * 3),
        ("written", c_int64),
        ("bears", c_double),
        # an answer that came after its tick's end, still in the buffers; whether one came in this tick
        ("belated", c_int64),
        ("belated_at", c_double),
        ("heard", c_int64),
        # forces taken, and the newest tick that was sampled
        ("taken", c_int64),
        ("asked", c_int64),
        # the mean force of the tick, up to a place in it: nodes/driver/mean_force.py
        ("split", c_double),
        ("mean", c_double * 3),
        # its safety, in the state active: nodes/driver/safety.py
        ("force", c_double * 3),
        ("force_seq", c_int64),
        ("since", c_int64),
        ("max_age", c_int64),
        ("watchdog", c_int64),
        ("slewed", c_double * 3),
        ("peak", c_double),
        ("slew", c_double),
        # its motion: nodes/driver/motion.py
        ("position", c_double * 3),
        ("before", c_double * 3),
        ("acting", c_double * 3),
        ("acted", c_double * 3),
        ("elapsed", c_int64),
        ("covered", c_int64),
        ("energy", c_double),
        ("highest", c_double),
        ("at", c_double),
        ("at_before", c_double),
        ("places", c_int64),
        ("places_at", c_int64),
        ("places_count", c_int64),
        ("lines", c_int64),
        ("line_length", c_int64),
        ("line_part", c_double),
        # its response times: nodes/driver/response_times.py
        ("recent", c_int64),
        ("recent_at", c_int64),
        ("bins", c_int64),
        ("counted", c_int64),
        ("longest", c_double),
        # the device: sim/device/model.py, sim/device/state.py
        ("mass", c_double),
        ("damping", c_double),
        ("grip", c_double),
        ("has_friction", c_int64),
        ("friction", c_double),
        ("has_resolution", c_int64),
        ("resolution", c_double),
        ("low", c_double),
        ("high", c_double),
        ("has_motor", c_int64),
        ("motor", c_double),
        ("device_axis", c_int64),
        ("x", c_double),
        ("v", c_double),
        ("device_ticks", c_int64),
        ("targets", c_int64),
        ("targets_from", c_int64),
        ("targets_count", c_int64),
        ("weight", c_double),
        # a page that may drag the hand: nodes/view/pointer.py (0 without one), what it wrote last, and `DraggedHand`
        ("pointer", c_int64),
        ("silence", c_double),
        ("wanted", c_double),
        ("wanted_at", c_double),
        ("farthest", c_double),
        ("is_away", c_int64),
        ("away", c_double),
        ("pull", c_double),
        # in lockstep: its delay, by whole ticks and a part
        ("commands", c_int64),
        ("commands_count", c_int64),
        ("slot", c_int64),
        ("early", c_double),
        ("early_map", c_double * 6),
        ("late", c_double),
        ("late_map", c_double * 6),
        # in real time: what acts, and what is on its way; sim/device/driver.py
        ("device_tick", c_int64),
        ("device_delay", c_double),
        ("device_hold", c_double),
        ("device_acting", c_double),
        ("commanded", c_double),
        ("pending", c_int64),
        ("pending_first", c_int64),
        ("pending_count", c_int64),
    ]
