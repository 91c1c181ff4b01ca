"""Virtual devices to identify: drawn at random, pushed as `nodes.laws.excitation` pushes, in one process."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np

from nodes.laws.excitation import Excitation
from sim.device.model import DeviceModel, Hand, quantise
from sim.identify.experiment import Experiment, lockstep
from sim.scene.loop import Scene, SceneSurface, run

PUSH = Excitation()
"""How they are pushed: as a launch pushes by default."""


def excite(model: DeviceModel, period: float, seconds: float, seed: int, peak: float = 3.3) -> Experiment:
    """Push a virtual device and note what its encoder reads."""
    anchor = SceneSurface("anchor", quantise(model.position, model.resolution))
    scene = Scene(device=model, surface=anchor, period=period, raw=False, clamp=False, peak=peak)
    law = msgspec.structs.replace(PUSH, seed=seed, duration=min(seconds, 600.0)).compile(period)
    trace = run(scene, law, round(seconds / period))
    return lockstep(period, trace.measured, trace.force)


@dataclass(frozen=True)
class Range:
    """What virtual devices are drawn from."""

    mass: tuple[float, float] = (0.03, 0.5)  # [kg], evenly in the logarithm, shape (2,)
    damping: tuple[float, float] = (0.05, 5.0)  # [N s/m], evenly in the logarithm, shape (2,)
    friction: tuple[float, float] = (0.0, 0.1)  # [N], shape (2,)
    delay: tuple[float, float] = (0.0, 2.5)  # [ticks], shape (2,)
    resolution: tuple[float, float] = (5e-6, 1e-4)  # encoder step [m], evenly in the logarithm, shape (2,)


def draw(number: int, seed: int, held: bool, ranges: Range | None = None) -> DeviceModel:
    """Draw one device."""
    ranges = ranges or Range()
    rng = np.random.default_rng([seed, number, int(held)])

    def logarithmic(low: float, high: float) -> float:
        return math.exp(rng.uniform(math.log(low), math.log(high)))

    hand = None
    model: dict[str, Any] = {
        "mass": logarithmic(*ranges.mass),
        "damping": logarithmic(*ranges.damping),
        "friction": float(rng.uniform(*ranges.friction)),
        "delay": float(rng.uniform(*ranges.delay)),
        "resolution": logarithmic(*ranges.resolution),
    }
    if held:
        hand = Hand(
            mass=logarithmic(0.05, 0.2),
            damping=logarithmic(1.0, 5.0),
            stiffness=logarithmic(100.0, 600.0),
            path=[(0.0, 0.0)],
        )
    return DeviceModel(**model, hand=hand)
