"""Replay a recorded sequence of delays: what a loop whose delay jitters really does, tick by tick.

Poles are those of a constant delay. A delay that changes from tick to tick can be worse than each of its values, and no pole
radius tells; so a design for a recorded loop is replayed on that loop's own delays, with the exact device in between.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

from nodes.laws import CompiledLaw
from nodes.stability.plant import Plant
from sim.device.model import advance, coefficients


def replayed_radius(law: CompiledLaw, plant: Plant, delays: Sequence[float]) -> float:
    """Measure by how much a released deflection grows or decays per tick, the delay of each force as given."""
    if law.sections:
        raise ValueError("law: only taps can be replayed")
    if len(delays) < 40:
        raise ValueError(f"delays: {len(delays)} ticks, at least 40 are needed for a first and a last quarter")
    past: deque[float] = deque([0.0] * len(law.taps), maxlen=len(law.taps))
    waiting: list[tuple[float, int, float]] = []
    x, v, force, newest = 1.0, 0.0, 0.0, -1
    trace = []

    def move(ticks: float) -> tuple[float, float]:
        return advance(x, v, force, coefficients(plant.mass, plant.damping, plant.stiffness, ticks * plant.period))

    for k, delay in enumerate(delays):
        past.appendleft(x)
        trace.append(abs(x) + abs(v) * plant.period)
        if not trace[-1] < 1e200:
            return math.inf
        waiting.append((k + delay, k, -sum(tap * value for tap, value in zip(law.taps, past, strict=True))))
        due = sorted(arrival for arrival in waiting if arrival[0] < k + 1)
        waiting = [arrival for arrival in waiting if arrival[0] >= k + 1]
        now = float(k)
        for at, seq, value in due:
            # A force that a younger one has overtaken never acts.
            if seq > newest:
                x, v = move(max(at - now, 0.0))
                now, force, newest = max(at, now), value, seq
        x, v = move(k + 1 - now)
    quarter = len(trace) // 4
    first, last = max(trace[:quarter]), max(trace[-quarter:])
    return math.exp((math.log(last) - math.log(first)) / (len(trace) - quarter)) if last > 0.0 else 0.0
