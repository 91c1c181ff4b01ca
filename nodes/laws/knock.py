"""Step test of a law: its taps feel a deflection step for some ticks, then a soft spring.

This tests a loop whose stability is in doubt. The law takes over in a running launch, steps in that
very tick, and gives up by itself after its time or as soon as the device swings far. Both are
counted in ticks, whether or not the requesting process still lives, so no law under test stays
active.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, ClassVar

import msgspec

from nodes.laws import CompiledLaw, Law
from nodes.laws.fields import MAX_TAPS
from nodes.parameters.checked import NonNegative, Positive

Ticks = Annotated[int, msgspec.Meta(ge=1, le=100_000)]


class Knock(Law, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """F[k] = F₀ + Σ h_m e[k−m] during the test; e: deflection since its start plus a step.

    taps: h_0 ... h_n of the law under test [N/m].
    step: Step of the deflection in the first tick, on the first axis [m].
    ticks: Duration of the test [ticks].
    far: Deflection that ends the test, in multiples of the step.
    stiffness: Spring before and after the test [N/m]. Its force at the start, F₀, continues during
        the test to carry a weight.
    damping: Damper before and after the test [N s/m].
    load: Constant force on the first axis that carries the device's weight [N].
    """

    kind: ClassVar[str] = "knock"
    example: ClassVar[dict[str, Any]] = {"taps": [2500.0, -1500.0], "step": 1e-4}
    internal: ClassVar[bool] = True

    taps: Annotated[tuple[float, ...], msgspec.Meta(min_length=1, max_length=MAX_TAPS)]
    step: float
    ticks: Ticks = 1600
    far: Positive = 3.0
    stiffness: Positive = 20.0
    damping: NonNegative = 0.5
    load: float = 0.0

    def compile(self, period: float) -> CompiledLaw:
        """Return the taps of spring and damper; the test is the law's own code."""
        damper = self.damping / period
        return CompiledLaw(
            (self.stiffness + damper, -damper), evaluate=Trial(self, damper)
        )


class Trial:
    """The step test on one axis; the first axis gets the step and carries the load."""

    def __init__(self, law: Knock, damper: float, axis: int = 0) -> None:
        self._law, self._damper = law, damper
        self._step, self._load = (law.step, law.load) if axis == 0 else (0.0, 0.0)
        self._far = law.far * abs(law.step)
        # deflection at the start [m], ticks since, ring head of the last tick (−1: before the
        # first)
        self._start = 0.0
        self._since = 0
        self._last = -1

    def on_axis(self, axis: int) -> Trial:
        """Return the test of an axis; called before the first tick."""
        return Trial(self._law, self._damper, axis)

    def __call__(self, ring: Sequence[float], head: int) -> float:
        """Return the force of a tick in addition to spring and damper [N]."""
        law = self._law
        damper = self._damper
        newest = ring[head]
        if self._since > law.ticks:
            return self._load
        if self._last < 0:
            # it takes over after the deflection of the previous tick
            self._start = ring[head + 1]
            self._since = 1
        else:
            # The ring stores everything twice, and its head moves down by one a tick, lost ticks
            # included.
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
