"""PD with adaptive windowing of the velocity: long windows at rest, short ones in motion.

The velocity is the slope of the longest line from the newest sample back that passes within an
encoder step of every sample between (Janabi-Sharifi, Hayward and Chen 2000): both ends and the
samples are wrong by half a step at most. That is no sum of taps, so the law has code of its own, a
pure function of the deflection history. Its stability is known from simulation and launches, not
from poles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import msgspec

from nodes.laws.base import CompiledLaw, Law
from nodes.laws.fields import Damping, Stiffness


class PDWindowed(Law, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """F = K x + B v, v the slope of the longest straight window.

    stiffness: K [N/m].
    damping: B [N s/m].
    resolution: Step of the encoder; samples within it of a line count as on the line [m].
    window: Longest window [ticks].
    """

    kind: ClassVar[str] = "pd_windowed"
    example: ClassVar[dict[str, Any]] = {
        "stiffness": 1000.0,
        "damping": 3.0,
        "resolution": 2.3e-5,
    }
    stiffness: Stiffness
    damping: Damping
    resolution: Annotated[float, msgspec.Meta(gt=0.0)]
    window: Annotated[int, msgspec.Meta(ge=1, le=64)] = 15

    def compile(self, period: float) -> CompiledLaw:
        """Return the tap of the spring; the damper is the law's own code."""
        taps = (self.stiffness, *(0.0,) * self.window)
        return CompiledLaw(
            taps,
            evaluate=WindowedDamper(
                self.damping / period, self.resolution, self.window
            ),
        )


def windowed_slope(
    ring: Sequence[float], head: int, error: float, window: int
) -> float:
    """Return the slope of the longest line back whose samples all lie within `error` of it."""
    newest = ring[head]
    # slightly more than the error, because encoder samples lie exactly on it
    error *= 1.0 + 1e-9
    slope = newest - ring[head + 1]
    for n in range(2, window + 1):
        wider = (newest - ring[head + n]) / n
        for i in range(1, n):
            off = newest - wider * i - ring[head + i]
            if off > error or off < -error:
                return slope
        slope = wider
    return slope


@dataclass(frozen=True)
class WindowedDamper:
    """The damper's code, over three numbers, so that a simulator can compile it."""

    gain: float
    error: float
    window: int

    def __call__(self, ring: Sequence[float], head: int) -> float:
        """Return the damper's force [N]."""
        return self.gain * windowed_slope(ring, head, self.error, self.window)
