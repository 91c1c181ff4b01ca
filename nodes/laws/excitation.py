"""A safe push for identifying a device: two pseudo-random forces over a soft spring that keeps it where it is.

It is a law like any other, so it takes over in a running launch by a swap and goes through all of
the driver's limits. The fast force tells mass and delay, the slow one damping and friction. Beyond
`reach` it only pushes back; a device that stays there (the edge of the workspace, a hand that pulls
it away) ends it for good, and so does the end of its time: what is left is the soft spring.
"""

from __future__ import annotations

import random
from collections.abc import Sequence
from typing import Annotated, ClassVar

import msgspec

from nodes.laws import CompiledLaw, Law
from nodes.parameters.checked import NonNegative, Positive

ClockTicks = Annotated[int, msgspec.Meta(ge=1, le=100_000)]

# time in which the load fades out when the push is over: a force that nobody asks for any more does
# not stay [s]
FADE = 1.0
ASTRAY = 100  # ticks in a row beyond twice the reach after which the push ends for good


def held_back(wanted: float, deflection: float, reach: float) -> float:
    """Turn a push towards the centre when the device is far from it."""
    if deflection > reach:
        return abs(wanted)
    if deflection < -reach:
        return -abs(wanted)
    return wanted


def went_on(k: int, astray: int, deflection: float, reach: float, ticks: int) -> tuple[int, int]:
    """Count the ticks pushed, and those in a row in which the device is astray; the last one when it is for too long."""
    astray = astray + 1 if abs(deflection) > 2.0 * reach else 0
    if astray < ASTRAY:
        return k + 1, astray
    return ticks, 0


def faded(load: float, since: int, fade: int) -> float:
    """Lower the load so many ticks after the push."""
    return load * float(fade - since) / fade


class Telegraph:
    """Pseudo-random telegraph signals in equal shares, each of which may change its sign after so many ticks."""

    def __init__(self, amplitude: float, clocks: Sequence[int], seed: int) -> None:
        self._signs = random.Random(seed)  # noqa: S311  # a repeatable push, no secret
        self._clocks = list(enumerate(clocks))
        self._share = amplitude / len(clocks)
        self._parts = [0.0] * len(clocks)
        self._ticks = 0

    def next(self) -> float:
        """Go on by one tick."""
        for i, clock in self._clocks:
            if self._ticks % clock == 0:
                self._parts[i] = self._share if self._signs.random() < 0.5 else -self._share
        self._ticks += 1
        return sum(self._parts)


class Excitation(Law, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Two-rate pseudo-random push over a centring spring; for an ``anchor`` surface at the place where the device is.

    amplitude: Largest pseudo-random force [N].
    duration: How long it pushes [s]; then only the spring is left.
    clocks: Ticks after which each of the forces may change its sign.
    stiffness: Centring spring [N/m].
    damping: Centring damper [N s/m].
    reach: Deflection beyond which it pushes back only [m].
    start: Time in which the push grows to its full size [s].
    seed: Of the pseudo-random signs; every axis has its own.
    load: Constant force on every axis, for a device whose weight nothing else carries [N]; fades
        out when the push is over.
    """

    kind: ClassVar[str] = "excitation"

    amplitude: Positive = 0.7
    duration: Annotated[float, msgspec.Meta(gt=0.0, le=600.0)] = 8.0
    clocks: Annotated[tuple[ClockTicks, ...], msgspec.Meta(min_length=1, max_length=4)] = (10, 60)
    stiffness: Positive = 20.0
    damping: NonNegative = 0.3
    reach: Positive = 0.03
    start: NonNegative = 0.2
    seed: Annotated[int, msgspec.Meta(ge=0)] = 1
    load: float = 0.0

    def compile(self, period: float) -> CompiledLaw:
        """Turn the spring and the damper into taps; the push is the law's own code."""
        damper = self.damping / period
        return CompiledLaw((self.stiffness + damper, -damper), evaluate=Push(self, period))


class Push:
    """The push, over the newest deflection of one axis; `axis` is its number, so that each has signs of its own."""

    def __init__(self, law: Excitation, period: float, axis: int = 0) -> None:
        self.law, self._period = law, period
        self.ticks, self.growing = max(1, round(law.duration / period)), law.start / period
        self.fade = max(1, round(FADE / period))
        self._pushed, self._astray, self._signal = 0, 0, self.signal(axis)

    def on_axis(self, axis: int) -> Push:
        """Give the push of an axis before its first tick."""
        return Push(self.law, self._period, axis)

    def signal(self, axis: int) -> Telegraph:
        """Give the pseudo-random force of an axis."""
        return Telegraph(self.law.amplitude, self.law.clocks, self.law.seed + axis)

    def __call__(self, ring: Sequence[float], head: int) -> float:
        """Push for a tick [N]."""
        load, reach, k = self.law.load, self.law.reach, self._pushed
        if k >= self.ticks:
            self._pushed = min(k + 1, self.ticks + self.fade)
            return faded(load, self._pushed - self.ticks, self.fade)
        self._pushed, self._astray = went_on(k, self._astray, ring[head], reach, self.ticks)
        share = (k + 1) / self.growing if k + 1 < self.growing else 1.0
        return load + share * held_back(self._signal.next(), ring[head], reach)
