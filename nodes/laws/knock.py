"""A law on trial: for some ticks its taps feel a step of the deflection, then a soft spring holds the device again.

How a loop is tried whose stability is in question. The law takes over in a running launch by a swap, knocks in that very
tick, and gives up by itself: after its time, or as soon as the device swings far. Both are counted in ticks, whoever asked for
it, and whether or not that process still lives. So no law stays that was only tried.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Annotated, Any, ClassVar

import msgspec

from nodes.laws import CompiledLaw, Law
from nodes.laws.fields import MAX_TAPS

Positive = Annotated[float, msgspec.Meta(gt=0.0)]
NonNegative = Annotated[float, msgspec.Meta(ge=0.0)]
Ticks = Annotated[int, msgspec.Meta(ge=1, le=100_000)]


class Knock(Law, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """F[k] = F₀ + Σ h_m e[k−m] while it is on trial, e the deflection since its start plus a step; a soft spring after that.

    Attributes
    ----------
    taps : tuple of float, shape (n + 1,)
        h_0 ... h_n of the law on trial [N/m].
    step : float
        Step of the deflection in its first tick, on the first axis [m].
    ticks : int
        How long the trial lasts [ticks].
    far : float
        The trial is over when a deflection is more than so many steps.
    stiffness : float
        Spring before and after the trial [N/m]. Its force at the start, F₀, goes on meanwhile: it carries a weight.
    damping : float
        Damper before and after the trial [N s/m].
    load : float
        Constant force on the first axis, for a device whose weight nothing else carries [N].
    axes : int
        How many axes the scene has.
    """

    kind: ClassVar[str] = "knock"

    taps: Annotated[tuple[float, ...], msgspec.Meta(min_length=1, max_length=MAX_TAPS)]
    step: float
    ticks: Ticks = 1600
    far: Positive = 3.0
    stiffness: Positive = 20.0
    damping: NonNegative = 0.5
    load: float = 0.0
    axes: Annotated[int, msgspec.Meta(ge=1, le=3)] = 1

    def compile(self, period: float) -> CompiledLaw:
        """Turn spring and damper into taps; the trial is the law's own code beside them."""
        damper = self.damping / period
        return CompiledLaw((self.stiffness + damper, -damper), evaluate=self._trial(damper))

    def _trial(self, damper: float) -> Callable[[Sequence[float], int], float]:
        taps, length, far = self.taps, len(self.taps), self.far * abs(self.step)
        # By the ring that it reads: deflection at the start, ticks since, step, last head and force, load.
        axes: dict[int, list[Any]] = {}

        def trial(ring: Sequence[float], head: int) -> float:
            axis = axes.get(id(ring))
            if axis is None:
                # Copies of the rings, on which a law is tried before it may render, come in the same order.
                step, load = (self.step, self.load) if len(axes) % self.axes == 0 else (0.0, 0.0)
                axis = axes[id(ring)] = [ring[head], 0, step, head, load, load]
            start, since, step, last, force, load = axis
            if head == last or since > self.ticks:
                return float(force)
            # A ring holds everything twice, and its head goes down by one a tick; lost ticks are filled in.
            since += (last - head) % (len(ring) // 2)
            newest = ring[head]
            if since > self.ticks or abs(newest - start + step) > far:
                since, force = self.ticks + 1, load
            else:
                force = load + self.stiffness * start - (self.stiffness + damper) * newest + damper * ring[head + 1]
                for m in range(min(length, since)):
                    force += taps[m] * (ring[head + m] - start + step)
            axis[1], axis[3], axis[4] = since, head, force
            return float(force)

        return trial
