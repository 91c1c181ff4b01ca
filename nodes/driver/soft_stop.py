"""The soft stop: the force on the device ramps down to zero before the driver ends."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from messages.types import ZERO, Vector
from nodes.base import realtime
from nodes.driver.device import Device
from nodes.driver.limits import STOP_TIME
from nodes.driver.state import DriverState

# longest soft stop [s], after which the device counts as hanging
SOFT_STOP = STOP_TIME + 1.0


def soft_stop(start: Vector, slew: float, period: float) -> list[Vector]:
    """Return the forces of a soft stop, ending at zero."""
    if start == ZERO:
        return [ZERO]
    steps = max(1, min(10, int(STOP_TIME / period)))
    if math.isfinite(slew):
        steps = max(steps, math.ceil(max(map(abs, start)) / slew))
    return [
        (start[0] * left / steps, start[1] * left / steps, start[2] * left / steps)
        for left in range(steps - 1, -1, -1)
    ]


def stop_softly(s: DriverState, device: Device, count: Callable[[int], None]) -> None:
    """Write the forces of a soft stop to a device, one a period in real time.

    `count` gets the number of each, from 1, before it is written.
    """
    x, y, z = s.handed
    written = s.epoch + s.written * s.period
    for n, force in enumerate(soft_stop((x, y, z), s.slew, s.period), 1):
        count(n)
        if s.realtime and time.monotonic() >= written + s.device_hold_ticks * s.period:
            # The driver was held up until the device let go by itself: the force must not return.
            force = ZERO
        device.write_force(force, s.seq + n - 1, 0.0)
        s.handed[:] = force
        if force == ZERO:
            break
        if s.realtime:
            written = time.monotonic()
            realtime.sleep_until(written + s.period)
