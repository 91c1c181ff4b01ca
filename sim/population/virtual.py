"""Virtual devices to identify: drawn at random, pushed as `nodes.laws.excitation` pushes, in one process."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nodes.laws.excitation import Excitation, Telegraph, held_back
from nodes.tick.kernels.sources import kernel
from sim.device.friction import move
from sim.device.model import DeviceModel, Hand, coefficients, quantise, split_delay
from sim.identify.experiment import Experiment, lockstep
from sim.scene.compiled import compiled

Array = NDArray[np.float64]

kernel(held_back)

PUSH = Excitation()
"""How they are pushed: as a launch pushes by default."""


@compiled()
def _push(
    wanted: Array,
    spring: float,
    damper: float,
    reach: float,
    peak: float,
    x: float,
    v: float,
    mass: float,
    damping: float,
    stiffness: float,
    friction: float,
    load: float,
    resolution: float | None,
    whole: int,
    part: float,
    period: float,
    positions: Array,
    forces: Array,
) -> None:
    """Push in closed loop over the centring spring, as driver and coupling do it."""
    ticks = len(wanted)
    early_map = coefficients(mass, damping, stiffness, part * period)
    late_map = coefficients(mass, damping, stiffness, (1.0 - part) * period)
    centre = quantise(x, resolution)
    before = centre
    for k in range(ticks):
        measured = quantise(x, resolution)
        force = held_back(wanted[k], centre - measured, reach)
        force -= spring * (measured - centre) + damper * (measured - before) / period
        before = measured
        force = min(max(force, -peak), peak)
        positions[k] = measured
        forces[k] = force
        if part > 0.0:
            acting = forces[k - whole - 1] if k - whole - 1 >= 0 else 0.0
            x, v = move(x, v, acting + load, part * period, early_map, mass, damping, stiffness, friction)
        acting = forces[k - whole] if k - whole >= 0 else 0.0
        x, v = move(x, v, acting + load, (1.0 - part) * period, late_map, mass, damping, stiffness, friction)


def excite(model: DeviceModel, period: float, seconds: float, seed: int, peak: float = 3.3) -> Experiment:
    """Push a virtual device and note what its encoder reads."""
    ticks = round(seconds / period)
    positions, forces = np.zeros(ticks), np.zeros(ticks)
    whole, part = split_delay(model.delay)
    signal = Telegraph(PUSH.amplitude, PUSH.clocks, seed)
    wanted: Array = np.array([signal.next() for _ in range(ticks)])
    _push(
        wanted, PUSH.stiffness, PUSH.damping, PUSH.reach, peak, model.position, model.velocity, model.moving_mass,
        model.moving_damping, model.grip, model.friction or 0.0, model.load(0, period), model.resolution, whole, part,
        period, positions, forces,
    )  # fmt: skip
    return lockstep(period, positions, forces)


@dataclass(frozen=True)
class Range:
    """What virtual devices are drawn from.

    Attributes
    ----------
    mass : tuple of float, shape (2,)
        [kg], evenly in the logarithm.
    damping : tuple of float, shape (2,)
        [N s/m], evenly in the logarithm.
    friction : tuple of float, shape (2,)
        [N].
    delay : tuple of float, shape (2,)
        [ticks].
    resolution : tuple of float, shape (2,)
        Encoder step [m], evenly in the logarithm.
    """

    mass: tuple[float, float] = (0.03, 0.5)
    damping: tuple[float, float] = (0.05, 5.0)
    friction: tuple[float, float] = (0.0, 0.1)
    delay: tuple[float, float] = (0.0, 2.5)
    resolution: tuple[float, float] = (5e-6, 1e-4)


def draw(number: int, seed: int, held: bool, ranges: Range | None = None) -> DeviceModel:
    """Draw one device."""
    ranges = ranges or Range()
    rng = np.random.default_rng([seed, number, int(held)])

    def logarithmic(low: float, high: float) -> float:
        return math.exp(rng.uniform(math.log(low), math.log(high)))

    hand = None
    model = {
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
