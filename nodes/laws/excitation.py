"""Safe excitation for identifying a device: pseudo-random forces over a soft spring.

It is a law like any other: it takes over in a running launch, and all of the driver's limits apply.
The fast force identifies mass and delay, the slow one damping and friction. Beyond `reach` it only
pushes back. If the device stays there (at the edge of its workspace, or pulled by a hand), the push
ends; so does it after `duration`. Then only the soft spring remains.
"""

from __future__ import annotations

import random
from collections.abc import Sequence
from typing import Annotated, ClassVar

import msgspec

from nodes.laws import CompiledLaw, Law
from nodes.parameters.checked import NonNegative, Positive

ClockTicks = Annotated[int, msgspec.Meta(ge=1, le=100_000)]

# time over which the load fades out after the push, so that no unrequested force remains [s]
FADE = 1.0
ASTRAY = 100  # successive ticks beyond twice the reach after which the push ends


def held_back(wanted: float, deflection: float, reach: float) -> float:
    """Return a push [N], directed towards the centre when the device is beyond `reach` [m]."""
    if deflection > reach:
        return abs(wanted)
    if deflection < -reach:
        return -abs(wanted)
    return wanted


def went_on(
    k: int, astray: int, deflection: float, reach: float, ticks: int
) -> tuple[int, int]:
    """Return the counts of ticks pushed and of successive ticks beyond twice the reach.

    After `ASTRAY` of the latter, the first count is `ticks`, which ends the push.
    """
    astray = astray + 1 if abs(deflection) > 2.0 * reach else 0
    if astray < ASTRAY:
        return k + 1, astray
    return ticks, 0


def faded(load: float, since: int, fade: int) -> float:
    """Return the load `since` ticks after the push, fading linearly to zero over `fade` ticks."""
    return load * float(fade - since) / fade


class Telegraph:
    """Sum of pseudo-random telegraph signals; each may change its sign every `clock` ticks."""

    def __init__(self, amplitude: float, clocks: Sequence[int], seed: int) -> None:
        self._signs = random.Random(seed)  # noqa: S311  # a reproducible push, not a secret
        self._clocks = list(enumerate(clocks))
        self._share = amplitude / len(clocks)
        self._parts = [0.0] * len(clocks)
        self._ticks = 0

    def next(self) -> float:
        """Return the force of the next tick [N]."""
        for i, clock in self._clocks:
            if self._ticks % clock == 0:
                self._parts[i] = (
                    self._share if self._signs.random() < 0.5 else -self._share
                )
        self._ticks += 1
        return sum(self._parts)


class Excitation(Law, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Two-rate pseudo-random push over a centring spring, for an ``anchor`` at the device.

    amplitude: Largest pseudo-random force [N].
    duration: Duration of the push [s]; then only the spring remains.
    clocks: Ticks after which each of the forces may change its sign.
    stiffness: Centring spring [N/m].
    damping: Centring damper [N s/m].
    reach: Deflection beyond which the force only pushes back [m].
    start: Ramp-up time of the push [s].
    seed: Seed of the pseudo-random signs; every axis has its own signs.
    load: Constant force on every axis that carries the device's weight [N]; fades out after the
        push.
    """

    kind: ClassVar[str] = "excitation"
    internal: ClassVar[bool] = True

    amplitude: Positive = 0.7
    duration: Annotated[float, msgspec.Meta(gt=0.0, le=600.0)] = 8.0
    clocks: Annotated[
        tuple[ClockTicks, ...], msgspec.Meta(min_length=1, max_length=4)
    ] = (10, 60)
    stiffness: Positive = 20.0
    damping: NonNegative = 0.3
    reach: Positive = 0.03
    start: NonNegative = 0.2
    seed: Annotated[int, msgspec.Meta(ge=0)] = 1
    load: float = 0.0

    def compile(self, period: float) -> CompiledLaw:
        """Return the taps of spring and damper; the push is the law's own code."""
        damper = self.damping / period
        return CompiledLaw(
            (self.stiffness + damper, -damper), evaluate=Push(self, period)
        )


class Push:
    """The push on one axis, from its newest deflection; each axis has signs of its own."""

    def __init__(self, law: Excitation, period: float, axis: int = 0) -> None:
        self.law, self._period = law, period
        self.ticks = max(1, round(law.duration / period))
        self.growing = law.start / period
        self.fade = max(1, round(FADE / period))
        self._pushed, self._astray, self._signal = 0, 0, self.signal(axis)

    def on_axis(self, axis: int) -> Push:
        """Return the push of an axis; called before the first tick."""
        return Push(self.law, self._period, axis)

    def signal(self, axis: int) -> Telegraph:
        """Return the pseudo-random force of an axis."""
        return Telegraph(self.law.amplitude, self.law.clocks, self.law.seed + axis)

    def __call__(self, ring: Sequence[float], head: int) -> float:
        """Return the push of a tick [N]."""
        load = self.law.load
        reach = self.law.reach
        k = self._pushed
        if k >= self.ticks:
            self._pushed = min(k + 1, self.ticks + self.fade)
            return faded(load, self._pushed - self.ticks, self.fade)
        self._pushed, self._astray = went_on(
            k, self._astray, ring[head], reach, self.ticks
        )
        share = (k + 1) / self.growing if k + 1 < self.growing else 1.0
        return load + share * held_back(self._signal.next(), ring[head], reach)
