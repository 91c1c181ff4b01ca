"""Virtual devices that the identified model does not fit: joints, lags, backlash and the rest of what hardware does.

These are integrated in small steps, 64 to a tick (midpoint rule, Coulomb friction exact within a step), because no closed form
knows all of them. Each kind is drawn about the same rigid device, so that what is told can be compared with what it is.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nodes.laws.excitation import Telegraph, held_back
from nodes.stability.flexible import FlexiblePlant
from sim.device.friction import slide
from sim.device.model import DeviceModel, coefficients, quantise
from sim.identify.experiment import Experiment, lockstep
from sim.population.virtual import PUSH, draw
from sim.scene.compiled import compiled

Array = NDArray[np.float64]

SUBSTEPS = 64
"""Steps of a tick."""


@dataclass(frozen=True)
class Outside:
    """A device with what the model of a rigid one does not have; 0 for what it lacks.

    Attributes
    ----------
    rigid : DeviceModel
        Mass of both sides of the joint, damping, Coulomb friction, delay, encoder.
    kind : str
        What it is drawn as, a key of `KINDS`.
    quadratic : float
        Damping that grows with the speed: force per speed squared [N s²/m²].
    lag : float
        Time constant of the actuator [s].
    share, frequency, loss : float
        Part of the mass beyond a joint, frequency [Hz] and damping ratio of the two masses against each other.
    gap : float
        Backlash of the joint [m].
    hardening : float
        Cubic spring to the middle [N/m³].
    presliding : float
        Deflection over which friction builds up (LuGre) [m].
    stribeck : float
        What friction is more at rest, as a part of it; it falls over 0.02 m/s.
    uneven : float
        What friction is more in one direction and less in the other, as a part of it.
    cogging : float
        Force of the motor's poles, 8 mm apart [N].
    ripple : float
        Error of the encoder, repeated every 1.3 mm [m].
    noise : float
        Of the position, before rounding, root mean square [m].
    jitter : float
        Samples come late by up to so much [ticks].
    late : float
        Forces come late by up to so much more than the delay [ticks].
    warming : float
        Part by which damping falls during the run.
    deadband : float
        Forces below it do nothing, and larger ones so much less [N].
    """

    rigid: DeviceModel
    kind: str = "rigid"
    quadratic: float = 0.0
    lag: float = 0.0
    share: float = 0.0
    frequency: float = 0.0
    loss: float = 0.0
    gap: float = 0.0
    hardening: float = 0.0
    presliding: float = 0.0
    stribeck: float = 0.0
    uneven: float = 0.0
    cogging: float = 0.0
    ripple: float = 0.0
    noise: float = 0.0
    jitter: float = 0.0
    late: float = 0.0
    warming: float = 0.0
    deadband: float = 0.0

    @property
    def plant(self) -> FlexiblePlant:
        """The linear device that it is, for poles of its loop."""
        rigid = self.rigid
        joint = {"share": self.share, "frequency": self.frequency, "loss": self.loss} if self.share else {}
        return FlexiblePlant(rigid.mass, rigid.damping, rigid.delay, lag=self.lag, **joint)


@compiled()
def _push(
    wanted: Array,
    taps: Array,
    law: tuple[float, float, float, float],
    body: tuple[float, float, float, float, float, float],
    odd: Array,
    sample: Array,
    arrive: Array,
    noise: Array,
    resolution: float,
    period: float,
    positions: Array,
    forces: Array,
) -> None:
    """Push in closed loop, as `sim.population.virtual` does; everything that acts is taken in the middle of each step."""
    centre, reach, peak, start = law
    mass, damping, friction, share, joint, loss = body
    quadratic, lag, gap, hardening, presliding, stribeck, uneven, cogging, ripple, warming, deadband = odd
    own = mass * (1.0 - share)
    beyond = mass * share
    step = period / 64.0
    x, v, y, w = start, 0.0, start, 0.0
    given, acting, bristle = 0.0, 0.0, 0.0
    deflections = np.zeros(len(taps))
    arrived = 0
    ticks = len(wanted)
    for k in range(ticks):
        now = 0.0
        sampled = False
        while now < 1.0:
            until, what = 1.0, 0
            if not sampled and sample[k] <= until:
                until, what = max(sample[k], now), 1
            if arrived < ticks and (arrived < k or (arrived == k and sampled)) and arrive[arrived] - k < until:
                until, what = max(arrive[arrived] - k, now), 2
            count = math.ceil((until - now) * period / step - 1e-9)
            for _ in range(count):
                h = (until - now) * period / count
                # The actuator's mean over the step, exact.
                mean = acting
                if lag > 0.0:
                    decay = math.exp(-h / lag)
                    mean = acting + (given - acting) * (1.0 - decay) * lag / h
                    given = acting + (given - acting) * decay
                u = mean
                if deadband > 0.0:
                    u = math.copysign(max(abs(mean) - deadband, 0.0), mean)
                mx, my = x + 0.5 * h * v, y + 0.5 * h * w
                speed = abs(v)
                u -= quadratic * v * speed + hardening * mx * mx * mx
                if cogging > 0.0:
                    u += cogging * math.sin(2.0 * math.pi * mx / 0.008)
                if share > 0.0:
                    stretch = mx - my
                    if gap > 0.0:
                        free = 0.5 * gap
                        stretch = math.copysign(max(abs(stretch) - free, 0.0), stretch)
                    pull = joint * stretch + (loss * (v - w) if stretch != 0.0 else 0.0)
                    u -= pull
                    w += h * pull / beyond
                    y += h * (w - 0.5 * h * pull / beyond)
                b = damping * (1.0 - warming * k / ticks)
                c = friction * (1.0 + stribeck * math.exp(-((speed / 0.02) ** 2)))
                c += friction * uneven * (1.0 if v > 0.0 else -1.0)
                if presliding > 0.0:
                    # LuGre: bristles stretch with the motion, at most by the presliding deflection.
                    rate = speed / presliding
                    end = math.copysign(presliding, v)
                    after = end + (bristle - end) * math.exp(-rate * h)
                    stiff = c / presliding
                    u -= stiff * 0.5 * (bristle + after) + 0.3 * math.sqrt(stiff * own) * (after - bristle) / h
                    bristle = after
                    c = 0.0
                x, v = slide(x, v, u, h, coefficients(own, b, 0.0, h), own, b, 0.0, c)
            now = until
            if what == 1:
                sampled = True
                read = x + noise[k]
                if ripple > 0.0:
                    read += ripple * math.sin(2.0 * math.pi * x / 0.0013)
                measured = quantise(read, resolution)
                deflections[1:] = deflections[:-1].copy()
                deflections[0] = centre - measured
                force = held_back(wanted[k], deflections[0], reach)
                for m in range(len(taps)):
                    force += taps[m] * deflections[m]
                positions[k] = measured
                forces[k] = min(max(force, -peak), peak)
            elif what == 2:
                acting = forces[arrived]
                arrived += 1


def excite_outside(device: Outside, period: float, seconds: float, seed: int, peak: float = 3.3) -> Experiment:
    """Push such a device and note what its encoder reads.

    Parameters
    ----------
    device : Outside
        The device; it begins at rest at 0.
    period : float
        Sampling period T [s].
    seconds : float
        How long it is pushed [s].
    seed : int
        Of the push, the noise and the jitter.
    peak : float
        Largest force [N].

    Returns
    -------
    Experiment
        As a driver records it: a tick's position counts as sampled at the tick, whenever it was.
    """
    ticks = round(seconds / period)
    signal = Telegraph(PUSH.amplitude, PUSH.clocks, seed)
    wanted: Array = np.array([signal.next() for _ in range(ticks)])
    damper = PUSH.damping / period
    taps = np.array([PUSH.stiffness + damper, -damper])
    return lockstep(period, *_played(device, period, wanted, taps, (0.0, PUSH.reach, peak, 0.0), seed))


def knock_outside(
    device: Outside, taps: Array, step: float, period: float, ticks: int, peak: float, start: float = 0.0
) -> Array:
    """Let a law feel a step of the deflection on such a device at rest.

    Parameters
    ----------
    device : Outside
        The device.
    taps : ndarray, shape (n + 1,)
        The law [N/m].
    step : float
        The step [m].
    period : float
        Sampling period T [s].
    ticks : int
        How long.
    peak : float
        Largest force [N].
    start : float
        Where it is, as a part of an encoder step.

    Returns
    -------
    ndarray, shape (ticks,)
        What the encoder reads [m].
    """
    place = start * (device.rigid.resolution or 0.0)
    return _played(device, period, np.zeros(ticks), taps, (step, math.inf, peak, place), 0)[0]


def _played(
    device: Outside, period: float, wanted: Array, taps: Array, law: tuple[float, float, float, float], seed: int
) -> tuple[Array, Array]:
    ticks = len(wanted)
    rng = np.random.default_rng([seed, 7])
    sample = rng.uniform(0.0, device.jitter, ticks) if device.jitter else np.zeros(ticks)
    late = rng.uniform(0.0, device.late, ticks) if device.late else np.zeros(ticks)
    arrive = np.maximum.accumulate(np.arange(ticks) + device.rigid.delay + late)
    noise = rng.normal(0.0, device.noise, ticks) if device.noise else np.zeros(ticks)
    rigid = device.rigid
    joint, loss = device.plant.joint if device.share else (0.0, 0.0)
    positions, forces = np.zeros(ticks), np.zeros(ticks)
    odd = np.array(
        [
            device.quadratic, device.lag, device.gap, device.hardening, device.presliding, device.stribeck,
            device.uneven, device.cogging, device.ripple, device.warming, device.deadband,
        ]
    )  # fmt: skip
    _push(
        wanted, np.asarray(taps, dtype=np.float64), law,
        (rigid.mass, rigid.damping, rigid.friction or 0.0, device.share, joint, loss), odd, sample, arrive, noise,
        rigid.resolution or 1e-9, period, positions, forces,
    )  # fmt: skip
    return positions, forces


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


def draw_outside(kind: str, number: int, seed: int) -> Outside:
    """Draw a device of a kind.

    Parameters
    ----------
    kind : str
        A key of `KINDS`.
    number : int
        Which one.
    seed : int
        Of the population.

    Returns
    -------
    Outside
        About a free device of the same ranges as those inside the model, with some friction.
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
    return Outside(rigid, kind, **drawn)
