"""How long after a force is handed over a device moves: short pulses up and down, and the position that answers each.

A handle that is held loosely answers as a mass with a damper. Each pulse is fitted with the
response of one, which begins d after the force was handed over; d is looked for, mass and damper
are whatever suits. So a soft hand counts as no delay.
"""

import math
import time
from typing import Final

import msgspec
import numpy as np

from messages.types import ZERO
from nodes.driver.hardware.mailbox import MailboxDevice
from sim.arrays import Array

PULSES: Final = 12
FORCE: Final = 1.0  # size of a pulse [N]; less where the device bears less
# How long it is looked at before a pulse, how long one lasts at most, and the rest after it [s].
BEFORE, PULSE, AFTER = 0.05, 0.06, 0.25
FAR: Final = 0.002  # a handle that went so far needs no more push [m]
LEAST: Final = 5e-5  # one that went less far was held too firmly [m]
LONGEST: Final = 0.04  # longest delay that is looked for [s]
# times in which a handle comes to its speed, m/b, that are tried [s]
TIMES: Final = (0.002, 0.005, 0.01, 0.02, 0.05, 0.2)


class MeasuredDelay(msgspec.Struct, frozen=True, kw_only=True):
    """A delay from force to effect."""

    # from handing a force over until a sample shows its effect begin [s]; None where it could not
    # be told
    delay: float | None
    uncertainty: float  # of it, at 95 % [s]
    pulses: int  # pulses that tell it
    why: str = ""  # why it could not be told; empty when it could


def _pulse(device: MailboxDevice, force: float) -> tuple[Array, Array]:
    """Push once; times from the moment of the force [s], and places [m], of all samples that were seen."""
    times: list[float] = []
    places: list[float] = []
    seen = device.ticks
    begun = time.monotonic()
    at, started = math.inf, 0.0
    try:
        while (now := time.monotonic()) < begun + BEFORE + PULSE:
            if at == math.inf and now >= begun + BEFORE:
                at = time.monotonic()
                started = places[-1] if places else 0.0
            # Each time anew: a force that nobody renews is let go.
            device.write_force((0.0, 0.0, force) if at < math.inf else ZERO, 0, 0.0)
            if device.ticks != seen:
                seen = device.ticks
                place, now = device.read_position(0)[2], time.monotonic()
                if math.isfinite(place):
                    times.append(now)
                    places.append(place)
                    if at < math.inf and abs(place - started) > FAR:
                        break
            time.sleep(0.0002)
    finally:
        device.write_force(ZERO, 0, 0.0)
    return np.array(times) - at, np.array(places)


def begins(times: Array, places: Array) -> float | None:
    """Find when a handle begins to follow a force that was handed over at time 0 [s]; None where it hardly moved."""
    before = places[times < 0.0]
    if before.size < 3 or times.size - before.size < 5 or abs(places[-1] - before[-1]) < LEAST:
        return None
    found = (math.inf, 0.0)
    for delay in np.arange(0.0, min(LONGEST, times[-1]), 2e-4):
        since = np.maximum(times - delay, 0.0)
        for constant in TIMES:
            response = since - constant * -np.expm1(-since / constant)
            columns = np.stack([np.ones_like(times), times, response], axis=1)
            fitted, *_ = np.linalg.lstsq(columns, places, rcond=None)
            found = min(found, (float(np.sum((columns @ fitted - places) ** 2)), float(delay)))
    return found[1]


def measure(device: MailboxDevice) -> MeasuredDelay:
    """Push a handle up and down by turns, which its user holds loosely."""
    size = min(FORCE, device.limits.peak_force)
    found = []
    for n in range(PULSES):
        delay = begins(*_pulse(device, size if n % 2 == 0 else -size))
        found += [] if delay is None else [delay]
        until = time.monotonic() + AFTER
        while time.monotonic() < until:
            device.write_force(ZERO, 0, 0.0)
            time.sleep(0.002)
    if len(found) < PULSES // 2:
        reason = device.condition() or "hold it more loosely"
        why = (
            f"only {len(found)} of {PULSES} pulses moved the handle by {1e3 * LEAST:g} mm: {reason}"
        )
        return MeasuredDelay(delay=None, uncertainty=math.inf, pulses=len(found), why=why)
    ordered = sorted(found)
    # A pulse in which the machine stalled says nothing: the median, and the spread of the middle
    # half of them.
    spread = ordered[(3 * len(ordered)) // 4] - ordered[len(ordered) // 4]
    error = 1.57 * spread / math.sqrt(len(ordered))
    # A sample may be as old as the time from one to the next, which is not seen.
    return MeasuredDelay(
        delay=float(np.median(ordered)),
        uncertainty=math.hypot(error, 1.0 / device.servo_rate),
        pulses=len(ordered),
    )
