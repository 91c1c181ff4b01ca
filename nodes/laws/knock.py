"""A law on trial: for some ticks its taps feel a step of the deflection, then a soft spring holds the device again.

How a loop is tried whose stability is in question. The law takes over in a running launch by a
swap, knocks in that very tick, and gives up by itself: after its time, or as soon as the device
swings far. Both are counted in ticks, whoever asked for it, and whether or not that process still
lives. So no law stays that was only tried.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, ClassVar

import msgspec

from nodes.laws import CompiledLaw, Law
from nodes.laws.fields import MAX_TAPS
from nodes.parameters.checked import NonNegative, Positive

Ticks = Annotated[int, msgspec.Meta(ge=1, le=100_000)]


class Knock(Law, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """F[k] = F₀ + Σ h_m e[k−m] while it is on trial, e the deflection since its start plus a step; a soft spring after that.

    taps: h_0 ... h_n of the law on trial [N/m].
    step: Step of the deflection in its first tick, on the first axis [m].
    ticks: How long the trial lasts [ticks].
    far: The trial is over when a deflection is more than so many steps.
    stiffness: Spring before and after the trial [N/m]. Its force at the start, F₀, goes on
        meanwhile: it carries a weight.
    damping: Damper before and after the trial [N s/m].
    load: Constant force on the first axis, for a device whose weight nothing else carries [N].
    """

    kind: ClassVar[str] = "knock"

    taps: Annotated[tuple[float, ...], msgspec.Meta(min_length=1, max_length=MAX_TAPS)]
    step: float
    ticks: Ticks = 1600
    far: Positive = 3.0
    stiffness: Positive = 20.0
    damping: NonNegative = 0.5
    load: float = 0.0

    def compile(self, period: float) -> CompiledLaw:
        """Turn spring and damper into taps; the trial is the law's own code beside them."""
        damper = self.damping / period
        return CompiledLaw((self.stiffness + damper, -damper), evaluate=Trial(self, damper))


class Trial:
    """The trial on one axis; the first one is knocked and carries the load."""

    def __init__(self, law: Knock, damper: float, axis: int = 0) -> None:
        self._law, self._damper = law, damper
        self._step, self._load = (law.step, law.load) if axis == 0 else (0.0, 0.0)
        self._far = law.far * abs(law.step)
        # Deflection at its start, ticks since, and where the head was in its last tick; nothing
        # before the first.
        self._start, self._since, self._last = 0.0, 0, -1

    def on_axis(self, axis: int) -> Trial:
        """Give the trial of an axis before its first tick."""
        return Trial(self._law, self._damper, axis)

    def __call__(self, ring: Sequence[float], head: int) -> float:
        """Force of a tick beside spring and damper [N]."""
        law, damper, newest = self._law, self._damper, ring[head]
        if self._since > law.ticks:
            return self._load
        if self._last < 0:
            # it takes over after the deflection of the tick before
            self._start, self._since = ring[head + 1], 1
        else:
            # A ring holds everything twice, and its head goes down by one a tick; lost ticks are
            # filled in.
            self._since += (self._last - head) % (len(ring) // 2)
        self._last = head
        start, step = self._start, self._step
        if self._since > law.ticks or abs(newest - start + step) > self._far:
            self._since = law.ticks + 1
            return self._load
        force = (
            self._load
            + law.stiffness * start
            - (law.stiffness + damper) * newest
            + damper * ring[head + 1]
        )
        for m in range(min(len(law.taps), self._since)):
            force += law.taps[m] * (ring[head + m] - start + step)
        return force
