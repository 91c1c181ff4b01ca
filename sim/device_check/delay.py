"""Measure the delay from a force command to the motion, with short pulses up and down.

A loosely held handle responds like a mass with a damper. The response of such a model, starting a
time d after the command, is fitted to each pulse; d is searched, mass and damper are free. So a
soft hand does not count as delay.
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
FORCE: Final = 1.0  # amplitude of a pulse, limited by the device [N]
# Observation before a pulse, its longest duration, and the pause after it [s].
BEFORE, PULSE, AFTER = 0.05, 0.06, 0.25
FAR: Final = 0.002  # movement at which a pulse ends [m]
SMALLEST_MOVE: Final = 5e-5  # movement below which the handle was held too firmly [m]
DELAY_LIMIT: Final = 0.04  # search limit of the delay [s]
# Time constants m/b of the handle that are tried [s].
TIMES: Final = (0.002, 0.005, 0.01, 0.02, 0.05, 0.2)


class MeasuredDelay(msgspec.Struct, frozen=True, kw_only=True):
    """Delay from force to effect."""

    # Time from the command until a sample shows the start of its effect [s]; None if unknown.
    delay: float | None
    uncertainty: float  # 95 % confidence half width [s]
    pulses: int  # pulses evaluated
    why: str = ""  # why it is unknown; empty if known


def _pulse(device: MailboxDevice, force: float) -> tuple[Array, Array]:
    """Apply one pulse; return times from the command [s] and positions [m] of all samples."""
    times: list[float] = []
    places: list[float] = []
    seen = device.ticks
    begun = time.monotonic()
    at = math.inf
    started = 0.0
    try:
        while (now := time.monotonic()) < begun + BEFORE + PULSE:
            if at == math.inf and now >= begun + BEFORE:
                at = time.monotonic()
                started = places[-1] if places else 0.0
            # Renewed each time: a device releases a force that is not renewed.
            device.write_force((0.0, 0.0, force) if at < math.inf else ZERO, 0, 0.0)
            if device.ticks != seen:
                seen = device.ticks
                place = device.read_position(0)[2]
                now = time.monotonic()
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
    """Return when a handle starts to follow a force commanded at time 0 [s].

    None if it hardly moved.
    """
    before = places[times < 0.0]
    if (
        before.size < 3
        or times.size - before.size < 5
        or abs(places[-1] - before[-1]) < SMALLEST_MOVE
    ):
        return None
    found = (math.inf, 0.0)
    for delay in np.arange(0.0, min(DELAY_LIMIT, times[-1]), 2e-4):
        since = np.maximum(times - delay, 0.0)
        for constant in TIMES:
            response = since - constant * -np.expm1(-since / constant)
            columns = np.stack([np.ones_like(times), times, response], axis=1)
            fitted, *_ = np.linalg.lstsq(columns, places, rcond=None)
            found = min(
                found, (float(np.sum((columns @ fitted - places) ** 2)), float(delay))
            )
    return found[1]


def measure(device: MailboxDevice) -> MeasuredDelay:
    """Push a loosely held handle up and down in turn; return the delay."""
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
            f"only {len(found)} of {PULSES} pulses moved the handle by"
            f" {1e3 * SMALLEST_MOVE:g} mm: {reason}"
        )
        return MeasuredDelay(
            delay=None, uncertainty=math.inf, pulses=len(found), why=why
        )
    ordered = sorted(found)
    # Robust against pulses in which the machine stalled: median and interquartile range.
    spread = ordered[(3 * len(ordered)) // 4] - ordered[len(ordered) // 4]
    error = 1.57 * spread / math.sqrt(len(ordered))
    # A sample may be up to one sampling period old.
    return MeasuredDelay(
        delay=float(np.median(ordered)),
        uncertainty=math.hypot(error, 1.0 / device.servo_rate),
        pulses=len(ordered),
    )
