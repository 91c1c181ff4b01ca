"""Random virtual devices, excited as by `nodes.laws.excitation`, in one process.

Devices outside the identified model (joints, lags, backlash etc.) are drawn kind by kind about the
same rigid ones, so that results can be compared with the truth.
"""

import math
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np

from nodes.laws.excitation import Excitation, Telegraph
from sim.arrays import Array
from sim.device.hand import Hand
from sim.device.model import DeviceModel, quantise
from sim.identify.experiment import Experiment, lockstep
from sim.play.nonideal import NonidealDevice, pushed
from sim.play.one_axis import run
from sim.play.one_axis_inputs import Scene, SceneSurface

PUSH = Excitation()  # excitation: a launch's default


def excite(
    model: DeviceModel, period: float, seconds: float, seed: int, peak: float = 3.3
) -> Experiment:
    """Excite a virtual device and return its encoder readings."""
    anchor = SceneSurface("anchor", quantise(model.position, model.resolution))
    scene = Scene(
        device=model, surface=anchor, period=period, raw=False, clamp=False, peak=peak
    )
    law = msgspec.structs.replace(
        PUSH, seed=seed, duration=min(seconds, 600.0)
    ).compile(period)
    trace = run(scene, law, round(seconds / period))
    return lockstep(period, trace.measured, trace.force)


Drawn = Callable[[np.random.Generator], float]


def _between(low: float, high: float) -> Drawn:
    """Return a log-uniform distribution."""
    return lambda rng: math.exp(rng.uniform(math.log(low), math.log(high)))


def _evenly(low: float, high: float) -> Drawn:
    return lambda rng: float(rng.uniform(low, high))


# Random parameters of a device and a hand: fields of `DeviceModel` and `Hand`.
RIGID: dict[str, Drawn] = {
    "mass": _between(0.03, 0.5),
    "damping": _between(0.05, 5.0),
    "friction": _evenly(0.0, 0.1),
    "delay": _evenly(0.0, 2.5),
    "resolution": _between(5e-6, 1e-4),
}
HAND: dict[str, Drawn] = {
    "mass": _between(0.05, 0.2),
    "damping": _between(1.0, 5.0),
    "stiffness": _between(100.0, 600.0),
}


def drawn(fields: dict[str, Drawn], rng: np.random.Generator) -> dict[str, Any]:
    """Draw fields in their order."""
    return {name: value(rng) for name, value in fields.items()}


def draw(number: int, seed: int, held: bool) -> DeviceModel:
    """Draw one device."""
    rng = np.random.default_rng([seed, number, int(held)])
    model = drawn(RIGID, rng)
    return DeviceModel(
        **model, hand=Hand(**drawn(HAND, rng), path=[(0.0, 0.0)]) if held else None
    )


def excite_outside(
    device: NonidealDevice, period: float, seconds: float, seed: int, peak: float = 3.3
) -> Experiment:
    """Excite such a device from rest at 0 and return its encoder readings.

    Readings are stamped with the tick, whatever their actual sampling time.
    """
    ticks = round(seconds / period)
    signal = Telegraph(PUSH.amplitude, PUSH.clocks, seed)
    wanted: Array = np.array([signal.next() for _ in range(ticks)])
    damper = PUSH.damping / period
    taps = np.array([PUSH.stiffness + damper, -damper])
    return lockstep(
        period,
        *pushed(device, period, wanted, taps, (0.0, PUSH.reach, peak, 0.0), seed),
    )


# Additional random parameters per kind.
KINDS: dict[str, dict[str, Drawn]] = {
    "flexible mode": {
        "share": _evenly(0.15, 0.6),
        "frequency": _between(15.0, 200.0),
        "loss": _between(0.01, 0.1),
    },
    "actuator lag": {"lag": _between(0.5e-3, 6e-3)},
    "quadratic damping": {"quadratic": _between(0.3, 4.0)},
    "presliding": {"presliding": _between(2e-5, 2e-4)},
    "backlash": {
        "gap": _between(5e-5, 1e-3),
        "share": _evenly(0.15, 0.6),
        "frequency": _between(100.0, 200.0),
        "loss": _between(0.02, 0.1),
    },
    "hardening spring": {"hardening": _between(1e4, 5e5)},
    "sampling jitter": {"jitter": _evenly(0.05, 0.4)},
    "delay jitter": {"late": _evenly(0.1, 0.8)},
    "stribeck": {"stribeck": _evenly(0.2, 1.0)},
    "uneven friction": {"uneven": _evenly(0.1, 0.5)},
    "cogging": {"cogging": _between(0.0005, 0.05)},
    "encoder ripple": {"ripple": _between(5e-6, 5e-5)},
    "eccentricity": {"ripple": _between(5e-6, 5e-5), "pitch": _between(0.01, 0.03)},
    "gain by sign": {"gain_by_sign": _between(0.001, 0.05)},
    "force steps": {"force_step": _between(0.001, 0.05)},
    "sensor average": {"average": _evenly(0.1, 0.5)},
    "sensor lag": {"sensor_lag": _between(0.5e-3, 4e-3)},
    "position noise": {"noise": _between(5e-6, 5e-5)},
    "warming up": {"warming": _evenly(0.2, 0.7)},
    "deadband": {"deadband": _between(0.01, 0.1)},
    "lag and mode": {
        "lag": _between(1e-3, 4e-3),
        "share": _evenly(0.2, 0.6),
        "frequency": _between(20.0, 120.0),
        "loss": _between(0.01, 0.1),
    },
}


def draw_outside(kind: str, number: int, seed: int) -> NonidealDevice:
    """Draw a device of a kind about a free device inside the model, with some friction."""
    rng = np.random.default_rng([seed, number, list(KINDS).index(kind)])
    rigid = draw(number, seed + 1000, held=False)
    rigid = msgspec.structs.replace(rigid, friction=max(rigid.friction or 0.0, 0.01))
    return NonidealDevice(rigid, kind, **drawn(KINDS[kind], rng))
