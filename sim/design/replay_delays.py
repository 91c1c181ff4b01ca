"""Replay a recorded sequence of delays: what a loop whose delay jitters really does, tick by tick.

Poles are those of a constant delay. A delay that changes from tick to tick can be worse than each of its values, and no pole
radius tells; so a design for a recorded loop is replayed on that loop's own delays, with the exact device in between.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from nodes.laws import CompiledLaw
from nodes.stability.plant import Plant
from sim.device.model import DeviceModel, Hand
from sim.scene.loop import Given, Scene, SceneSurface, run

GIVEN_UP = 1e200
"""Deflection from which on a loop is called unstable whatever comes [m]."""


def replayed_radius(law: CompiledLaw, plant: Plant, delays: Sequence[float]) -> float:
    """Measure by how much a released deflection grows or decays per tick, the delay of each force as given."""
    if law.sections:
        raise ValueError("law: only taps can be replayed")
    if len(delays) < 40:
        raise ValueError(f"delays: {len(delays)} ticks, at least 40 are needed for a first and a last quarter")
    hand = Hand(stiffness=plant.stiffness, path=[(0.0, 0.0)]) if plant.stiffness else None
    device = DeviceModel(mass=plant.mass, damping=plant.damping, position=1.0, hand=hand)
    scene = Scene(device=device, surface=SceneSurface("anchor"), period=plant.period, raw=False, clamp=False)
    arrivals: list[tuple[float, int]] = []
    for at, seq in sorted((k + delay, k) for k, delay in enumerate(delays)):
        # A force that a younger one has overtaken never acts.
        if not arrivals or seq > arrivals[-1][1]:
            arrivals.append((at, seq))
    when, answers = (
        np.array([at for at, _ in arrivals], dtype=np.float64),
        np.array([seq for _, seq in arrivals], dtype=np.int64),
    )
    with np.errstate(all="ignore"):
        trace = run(
            scene, law, len(delays), interpreted=True, given=Given(arrivals=(when, answers, np.zeros(len(when))))
        )
        size = np.abs(trace.position) + np.abs(trace.velocity) * plant.period
    if not np.all(size < GIVEN_UP):
        return math.inf
    quarter = len(size) // 4
    first, last = float(np.max(size[:quarter])), float(np.max(size[-quarter:]))
    return math.exp((math.log(last) - math.log(first)) / (len(size) - quarter)) if last > 0.0 else 0.0
