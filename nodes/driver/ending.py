"""How a run ends, from its last samples: at rest, swinging (how far and how often), falling, or going somewhere."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

REST = 1e-6
"""Largest swing that counts as rest [m]: about what a fingertip feels at its most sensitive, near 250 Hz."""

_FALL = 1.0
"""Least acceleration without a force that is called falling [m/s²]: a damped device that glides has less."""


class Ending(NamedTuple):
    """The last samples of one axis in words and figures."""

    motion: str  # ``at rest``, ``swinging``, ``falling`` or ``moving``
    swing_m: float  # largest less smallest sample, in metres
    frequency_hz: float  # how often it swings to and fro, in Hz; 0 for any other motion
    velocity_m_per_s: float  # at the end, in m/s


def ending(samples: Sequence[float], force: float, period: float) -> Ending:
    """Describe the last samples of one axis."""
    if len(samples) < 2:
        return Ending("at rest", 0.0, 0.0, 0.0)
    swing = max(samples) - min(samples)
    velocity = (samples[-1] - samples[-2]) / period
    if not swing > REST:
        return Ending("at rest", swing, 0.0, velocity)
    middle = 0.5 * (max(samples) + min(samples))
    above = [value > middle for value in samples]
    crossings = [k for k in range(1, len(above)) if above[k] != above[k - 1]]
    # Twice through the middle is there and back; a third time makes it a swing.
    if len(crossings) >= 3:
        frequency = 0.5 * (len(crossings) - 1) / ((crossings[-1] - crossings[0]) * period)
        return Ending("swinging", swing, frequency, velocity)
    half = (len(samples) - 1) // 2
    bend = samples[-1] - 2.0 * samples[-1 - half] + samples[-1 - 2 * half]
    acceleration = bend / (half * period) ** 2 if half else 0.0
    falls = force == 0.0 and abs(acceleration) > _FALL and acceleration * velocity > 0.0
    return Ending("falling" if falls else "moving", swing, 0.0, velocity)
