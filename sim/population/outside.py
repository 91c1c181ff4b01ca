"""Virtual devices that the identified model does not fit, drawn at random: joints, lags, backlash and the rest.

Each kind is drawn about the same rigid device, so that what is told can be compared with what it is.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from nodes.laws.excitation import Telegraph
from sim.arrays import Array
from sim.device.model import DeviceModel
from sim.identify.experiment import Experiment, lockstep
from sim.population.virtual import PUSH, draw
from sim.scene.richer import RicherModel, pushed


def excite_outside(device: RicherModel, period: float, seconds: float, seed: int, peak: float = 3.3) -> Experiment:
    """Push such a device and note what its encoder reads.

    `device`: the device; it begins at rest at 0. Returns: as a driver records it: a tick's position counts as sampled at the
    tick, whenever it was.
    """
    ticks = round(seconds / period)
    signal = Telegraph(PUSH.amplitude, PUSH.clocks, seed)
    wanted: Array = np.array([signal.next() for _ in range(ticks)])
    damper = PUSH.damping / period
    taps = np.array([PUSH.stiffness + damper, -damper])
    return lockstep(period, *pushed(device, period, wanted, taps, (0.0, PUSH.reach, peak, 0.0), seed))


def _between(low: float, high: float) -> Callable[[np.random.Generator], float]:
    return lambda rng: math.exp(rng.uniform(math.log(low), math.log(high)))


KINDS: dict[str, dict[str, Callable[[np.random.Generator], float]]] = {
    "flexible mode": {
        "share": lambda rng: float(rng.uniform(0.15, 0.6)),
        "frequency": _between(15.0, 200.0),
        "loss": _between(0.01, 0.1),
    },
    "actuator lag": {"lag": _between(0.5e-3, 6e-3)},
    "quadratic damping": {"quadratic": _between(0.3, 4.0)},
    "presliding": {"presliding": _between(2e-5, 2e-4)},
    "backlash": {
        "gap": _between(5e-5, 1e-3),
        "share": lambda rng: float(rng.uniform(0.15, 0.6)),
        "frequency": _between(100.0, 200.0),
        "loss": _between(0.02, 0.1),
    },
    "hardening spring": {"hardening": _between(1e4, 5e5)},
    "sampling jitter": {"jitter": lambda rng: float(rng.uniform(0.05, 0.4))},
    "delay jitter": {"late": lambda rng: float(rng.uniform(0.1, 0.8))},
    "stribeck": {"stribeck": lambda rng: float(rng.uniform(0.2, 1.0))},
    "uneven friction": {"uneven": lambda rng: float(rng.uniform(0.1, 0.5))},
    "cogging": {"cogging": _between(0.005, 0.05)},
    "encoder ripple": {"ripple": _between(5e-6, 5e-5)},
    "position noise": {"noise": _between(5e-6, 5e-5)},
    "warming up": {"warming": lambda rng: float(rng.uniform(0.2, 0.7))},
    "deadband": {"deadband": _between(0.01, 0.1)},
    "lag and mode": {
        "lag": _between(1e-3, 4e-3),
        "share": lambda rng: float(rng.uniform(0.2, 0.6)),
        "frequency": _between(20.0, 120.0),
        "loss": _between(0.01, 0.1),
    },
}
"""What each kind has, drawn at random."""
UNFORESEEN = ("warming up", "deadband", "uneven friction", "delay jitter")
"""Kinds that no term was written for."""


def draw_outside(kind: str, number: int, seed: int) -> RicherModel:
    """Draw a device of a kind.

    Returns: about a free device of the same ranges as those inside the model, with some friction.
    """
    rng = np.random.default_rng([seed, number, list(KINDS).index(kind)])
    rigid = draw(number, seed + 1000, held=False)
    rigid = DeviceModel(
        mass=rigid.mass,
        damping=rigid.damping,
        friction=max(rigid.friction or 0.0, 0.01),
        delay=rigid.delay,
        resolution=rigid.resolution,
    )
    drawn: dict[str, Any] = {name: value(rng) for name, value in KINDS[kind].items()}
    return RicherModel(rigid, kind, **drawn)
