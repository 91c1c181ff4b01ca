"""The time of tick 0 in real time, from which a respawned driver counts on."""

from __future__ import annotations

import math
import time
from pathlib import Path

from nodes.driver.state import DriverState

_AHEAD = 0.002  # from the first driver's start to its tick 0 [s]


def begin_at_epoch(s: DriverState, path: Path) -> None:
    """Set the epoch [s], read from `path` or written to it, and the first tick.

    A file that exists was left by a driver that was killed with a force on the device: the first
    force of its successor is a recovery.
    """
    if path.exists():
        s.ramp_ticks = s.recovery_ticks
        s.always_ramp = 1
        s.epoch = float(path.read_text(encoding="ascii"))
    else:
        s.epoch = time.monotonic() + _AHEAD
        path.write_text(repr(s.epoch), encoding="ascii")
    s.seq = max(0, math.ceil((time.monotonic() - s.epoch) / s.period))
