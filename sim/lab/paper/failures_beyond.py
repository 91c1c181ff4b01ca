"""Limits of methods beyond a rigid device at one rate, each checked by a second method.

The cases are joint, two rates, encoder and friction, jitter, bounce, slide and unknown world. Each
boundary comes from one method and is checked on both sides by an independent one: poles of a joint
by integration in small steps, a certificate for jitter by a sequence of delays, an unknown world by
constructing the worst one.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from nodes.laws import CompiledLaw
from nodes.laws.pd import PD
from nodes.stability.flexible import FlexiblePlant
from nodes.stability.k_max import k_max, without_spring
from nodes.stability.plant import Plant, held_plant
from nodes.stability.world_loop import Body, world_radius
from nodes.stability.worlds import AnyWorld, world_k_max
from sim.arrays import Array
from sim.device.model import DeviceModel, advance, coefficients, quantise
from sim.stability.every_delay import Certificate, every_delay
from sim.stability.rest import rest
from sim.stability.two_rate import TwoRate, two_rate_k_max

PERIOD = 0.002  # T of everything below [s]: the paper's
MASS, DAMPING = 0.1, 1.0  # of the device [kg], [N s/m]
RESOLUTION = 2.3e-5  # of its encoder [m]
# root-mean-square second difference of a position above which a contact chatters [m]
TURNS = 2e-5


@dataclass(frozen=True)
class BeyondEdge:
    """A boundary found by one method and checked on both sides by another."""

    name: str  # the extension beyond a rigid device at one rate
    quantity: str  # the quantity that is raised, with its unit
    value: float  # boundary by the first method, in that unit
    margin: float  # relative distance of the checks from it
    methods: str  # the first method, and the second
    # Whether the second method is stable on the inner side, and on the outer.
    inside: bool
    outside: bool

    @property
    def agreed(self) -> bool:
        """Whether the second method places the boundary between the two sides."""
        return self.inside and not self.outside


def _pd(stiffness: float, gain: float) -> CompiledLaw:
    return PD(stiffness=stiffness, damping=gain).compile(PERIOD)


def joint() -> BeyondEdge:
    """Return the stability limit with a joint of 40 Hz, by poles and by integration.

    The integration takes 64 steps a tick.
    """
    from sim.identify.alterations import stiffest
    from sim.play.nonideal import NonidealDevice, pushed

    beyond = {"share": 0.4, "frequency": 40.0, "loss": 0.02}
    gain, margin, ticks = 2.0, 0.02, 6000
    edge = stiffest(FlexiblePlant(MASS, DAMPING, **beyond), PERIOD, gain)
    assert edge is not None  # noqa: S101 - a soft wall is stable on this device
    model = NonidealDevice(
        DeviceModel(mass=MASS, damping=DAMPING), "flexible mode", **beyond
    )

    def rests(stiffness: float) -> bool:
        taps = np.array(_pd(stiffness, gain).taps)
        # Released 10 mm from an anchor, at rest.
        position, _ = pushed(
            model, PERIOD, np.zeros(ticks), taps, (0.0, 1.0, math.inf, 0.01), 1
        )
        return _shrinks(position)

    sides = rests(edge * (1.0 - margin)), rests(edge * (1.0 + margin))
    return BeyondEdge(
        "a joint of 40 Hz, two fifths of the mass",
        "K [N/m]",
        edge,
        margin,
        "poles; small steps",
        *sides,
    )


def _shrinks(position: Array) -> bool:
    """Whether a swing about 0 decreases from its second quarter to its last."""
    quarter = len(position) // 4
    early, late = (
        np.abs(position[quarter : 2 * quarter]).max(),
        np.abs(position[-quarter:]).max(),
    )
    return bool(late < early)


def two_rates() -> BeyondEdge:
    """Return the limit of a spring under a servo at four times the rate.

    By the lifted map, and by playing the servo's ticks.
    """
    device, margin = TwoRate(MASS, DAMPING, 3.0, 4, 4), 0.002
    edge = two_rate_k_max(CompiledLaw((0.0,)), PERIOD, device)
    assert edge is not None  # noqa: S101
    short = PERIOD / device.ratio
    step = coefficients(MASS, DAMPING, 0.0, short)

    def rests(stiffness: float) -> bool:
        x, v, before, seen = 0.01, 0.0, 0.01, []
        waiting = [0.0] * (device.delay + 1)
        for k in range(60_000):
            if k % device.ratio == 0:
                force = -stiffness * x
                seen.append(x)
            waiting = [force, *waiting[:-1]]
            servo = -device.servo_damping * (x - before) / short
            before = x
            x, v = advance(x, v, waiting[device.delay] + servo, step)
        return _shrinks(np.array(seen))

    sides = rests(edge * (1.0 - margin)), rests(edge * (1.0 + margin))
    return BeyondEdge(
        "a servo at four times the rate",
        "K [N/m]",
        edge,
        margin,
        "lifted map; servo ticks",
        *sides,
    )


def encoder_and_friction() -> BeyondEdge:
    """Return the friction that stops chatter across one encoder edge.

    By H(−1), and by the work of that motion.
    """
    law, margin, path = _pd(1000.0, 3.0), 0.002, 1e-9
    edge = rest(law, PERIOD, RESOLUTION).friction_alternating_n
    x = np.where(
        np.arange(4000) % 2,
        10.5 * RESOLUTION + 0.5 * path,
        10.5 * RESOLUTION - 0.5 * path,
    )
    read = np.array([quantise(float(value), RESOLUTION) for value in x])
    force = -np.convolve(read, law.taps)[: len(x)]
    # An even number of ticks: the mean force does no work. The direction is the worst case.
    work = abs(float((force[100:-2] * np.diff(x)[100:-1]).mean()))

    def moves(friction: float) -> bool:
        return work > friction * path

    sides = not moves(edge * (1.0 + margin)), not moves(edge * (1.0 - margin))
    return BeyondEdge(
        "encoder of 23 µm and friction",
        "friction [N]",
        edge,
        -margin,
        "Δ |H(−1)|/2; work of a motion",
        *sides,
    )


def jitter() -> BeyondEdge:
    """Return the limit with a delay that jitters by half a tick.

    By a certificate, and by the delay sequence that grows.
    """
    gain, delays, margin = 3.0, (0.5, 1.0), 0.05
    plant = Plant(PERIOD, MASS, DAMPING)
    low, high = (
        100.0,
        k_max(
            without_spring(PD(stiffness=1.0, damping=gain), PERIOD), plant
        ).k_max_n_per_m
        or 0.0,
    )
    while high - low > 0.01 * high:
        middle = 0.5 * (low + high)
        low, high = (
            (low, middle)
            if every_delay(_pd(middle, gain), plant, delays).stable
            is Certificate.UNSTABLE
            else (middle, high)
        )
    outer = _pd(high * (1.0 + margin), gain)
    worst = every_delay(outer, plant, delays).growing
    inner = _pd(high * (1.0 - margin), gain)
    certified = bool(every_delay(inner, plant, delays).stable)
    sides = (
        certified and not _grows(inner, plant, worst),
        not _grows(outer, plant, worst),
    )
    return BeyondEdge(
        "a delay of 0.5 to 1 ticks",
        "K [N/m]",
        high,
        margin,
        "certificate; the sequence, played",
        *sides,
    )


def _grows(law: CompiledLaw, plant: Plant, delays: tuple[float, ...]) -> bool:
    """Play a swing with a repeated sequence of delays and return whether it grows.

    Each force acts from its arrival within the tick.
    """
    x, v = 0.01, 0.0
    history = [0.0] * len(law.taps)
    arrivals: list[tuple[float, float]] = []
    acting, seen = 0.0, []
    for k in range(4000):
        seen.append(x)
        history = [-x, *history[:-1]]
        force = sum(tap * one for tap, one in zip(law.taps, history, strict=True))
        arrivals.append((k + delays[k % len(delays)], force))
        now = 0.0
        while arrivals and arrivals[0][0] < k + 1:
            at, following = arrivals.pop(0)
            x, v = _moved(x, v, acting, (at - k - now) * plant.period, plant)
            acting, now = following, at - k
        x, v = _moved(x, v, acting, (1.0 - now) * plant.period, plant)
    return not _shrinks(np.array(seen))


def _moved(
    x: float, v: float, force: float, duration: float, plant: Plant
) -> tuple[float, float]:
    if duration <= 0.0:
        return x, v
    return advance(
        x, v, force, coefficients(plant.mass, plant.damping, plant.stiffness, duration)
    )


def bounce() -> BeyondEdge:
    """Return the stiffness at which a drop bounces below the linear limit.

    By the simulator, and by the designer's map.
    """
    from sim.design.demand import Demand
    from sim.design.fall import falls, settled
    from sim.experiments.drop import CONVENTION, drop_scene, held
    from sim.experiments.settling import Criterion, settles

    horizon = Criterion(20_000)
    gain, margin, plant = 8.0, 0.03, Plant(PERIOD, MASS, DAMPING)
    linear = (
        k_max(
            without_spring(PD(stiffness=1.0, damping=gain), PERIOD), plant
        ).k_max_n_per_m
        or 0.0
    )
    low, high = 0.5 * linear, linear
    while high - low > 1e-3 * high:
        middle = 0.5 * (low + high)
        low, high = (
            (middle, high)
            if settles(drop_scene(held(plant), PERIOD), [_pd(middle, gain)], horizon)[0]
            else (low, middle)
        )
    drops = falls(
        Demand((MASS, MASS), DAMPING, (0.0, 0.0), PERIOD, 0.99, 1e6),
        [MASS],
        [CONVENTION],
        [0.01],
    )
    sides = (
        settled(_pd(high * share, gain), drops, horizon)[0]
        for share in (1.0 - margin, 1.0 + margin)
    )
    name = f"a landing, at {100.0 * high / linear:.0f} % of the linear edge"
    return BeyondEdge(
        name,
        "K [N/m]",
        high,
        margin,
        "drop by closed form; by matrix exponential",
        *sides,
    )


def slide() -> BeyondEdge:
    """Return the limit of a device that a hand slides along a rough plane.

    By poles, and by playing the launch in space.
    """
    from nodes.launcher import launch_file
    from sim.play.player import play

    margin, gain = 0.1, 2.0
    plant = Plant(PERIOD, 0.15, 3.0, 0.0, 150.0)
    edge = (
        k_max(
            without_spring(PD(stiffness=1.0, damping=gain), PERIOD), plant
        ).k_max_n_per_m
        or 0.0
    )

    def quiet(stiffness: float) -> bool:
        launch = launch_file.read(
            "rough_plane", {"stiffness": stiffness, "damping": gain, "duration": 2.0}
        )
        position = play(launch).measured
        # The motions of hand and slide are slow; an unstable contact reverses every few
        # ticks.
        turns = np.diff(position[len(position) // 2 :], 2, axis=0)
        return bool(np.sqrt(np.mean(np.sum(turns**2, axis=1))) < TURNS)

    sides = quiet(edge * (1.0 - margin)), quiet(edge * (1.0 + margin))
    return BeyondEdge(
        "a slide along a rough plane",
        "K [N/m]",
        edge,
        margin,
        "poles; the launch, played",
        *sides,
    )


def unknown_world() -> BeyondEdge:
    """Return the limit for any passive world that answers in the same tick.

    By a certificate, and by constructing the worst world. The certificate is (18.2) of
    THEORY.md: Re{D/H + D P} > 0, D = (1 − w)/T, on the whole circle, and stability at the wall.
    """
    gain, margin = 3.0, 0.002
    plant = Plant(PERIOD, MASS, DAMPING)
    edge = world_k_max(
        without_spring(PD(stiffness=1.0, damping=gain), PERIOD), plant, AnyWorld()
    ).k_max_n_per_m
    assert edge is not None  # noqa: S101 - a soft law is certified on this device
    held = held_plant(plant)
    theta = np.concatenate(
        [np.geomspace(1e-4, 1e-2, 400), np.linspace(1e-2, math.pi, 40_001)]
    )
    z = np.exp(1j * theta)
    slope = (1.0 - 1.0 / z) / PERIOD
    device = (
        slope * np.polyval(held.numerator, z) / (np.polyval(held.denominator, z) * z)
    )

    def share(stiffness: float) -> Array:
        return np.asarray(slope / _pd(stiffness, gain).response(z) + device)

    def stands(stiffness: float) -> bool:
        """Whether the poles stay inside with the worst lossless first-order world.

        That world cancels the remaining imaginary part at its frequency.
        """
        left = share(stiffness)
        at = int(np.argmin(left.real))
        # (18.1): Y = −jσ there, a mass T/(2σ tan(θ/2)) where σ > 0, a spring −2 tan(θ/2)/(σ T)
        # where σ < 0.
        sigma, half = float(left[at].imag), math.tan(0.5 * float(theta[at]))
        if sigma > 0.0:
            world = Body(mass=PERIOD / (2.0 * sigma * half), integrator="lossless")
        else:
            world = Body(
                stiffness=-2.0 * half / (sigma * PERIOD), integrator="lossless"
            )
        return world_radius(_pd(stiffness, gain), plant, world) < 1.0

    sides = stands(edge * (1.0 - margin)), stands(edge * (1.0 + margin))
    return BeyondEdge(
        "any passive world, answering at once",
        "K [N/m]",
        edge,
        margin,
        "certificate; worst world's poles",
        *sides,
    )


# Cases; add a function here for another one.
BEYOND: tuple[Callable[[], BeyondEdge], ...] = (
    joint,
    two_rates,
    encoder_and_friction,
    jitter,
    bounce,
    slide,
    unknown_world,
)
