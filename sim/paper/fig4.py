"""The paper's figure 4: the largest stiffness that survives the drop, over the damping gain B, law by law.

The same drop for PD (plain, with a filtered and with a windowed velocity), the paper's optimum, a law designed for the same
delay and half to twice the mass, and one designed for this very drop: without delay and a tick late, with a perfect sensor
and the Touch X's (resolution and friction, which only matter together). Stiffness is told twice, nominal K and H(1), what is
felt; and the frequency at which the device really swings at the limit is measured.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from nodes.laws import CompiledLaw
from nodes.laws.parse import parse_law
from nodes.laws.pd import PD
from nodes.laws.pd_filtered import PDFiltered
from nodes.laws.pd_windowed import PDWindowed
from nodes.stability.k_max import k_max, with_spring, without_spring
from nodes.stability.plant import Plant
from sim.design.demand import CONVENTIONS, Demand, Robust
from sim.device.model import DeviceModel
from sim.experiments.drop import Criterion, drop_scene
from sim.experiments.k_max_simulated import SearchInterrupted, SimulatedKMax, simulated_boundary

Step = Callable[[str, int], None]
Family = Callable[[float], CompiledLaw]

LAWS = ("pd", "pd_filtered", "pd_windowed", "paper_optimum", "designed", "designed_drop")
DELAYS = (0.0, 1.0)
CUTOFF = 100.0
"""Of the filtered velocity [Hz], a fifth of the paper's rate."""


@dataclass(frozen=True)
class Setting:
    """What is dropped, and how.

    Attributes
    ----------
    mass, damping : float
        Device [kg], [N s/m].
    period : float
        Sampling period T [s].
    gains : tuple of float
        Damping gains B of the horizontal axis [N s/m].
    resolution, friction : float
        Of the Touch X [m], [N]; the friction is a data-sheet figure quoted from memory (THEORY.md §4).
    criterion : Criterion
        Horizon and tolerance, the same for every law.
    """

    mass: float
    damping: float
    period: float
    gains: tuple[float, ...]
    resolution: float = 2.3e-5
    friction: float = 0.06
    criterion: Criterion = field(default_factory=Criterion)

    def device(self, delay: float, touch: bool) -> DeviceModel:
        """Describe the device."""
        resolution, friction = (self.resolution, self.friction) if touch else (None, None)
        return DeviceModel(mass=self.mass, damping=self.damping, delay=delay, resolution=resolution, friction=friction)

    def held(self, delay: float) -> Plant:
        """Describe the same as the linear loop sees it."""
        return Plant(self.period, self.mass, self.damping, delay)


@dataclass(frozen=True)
class Curve:
    """One boundary.

    Attributes
    ----------
    law : str
        One of `LAWS`.
    delay : float
        Of the loop [ticks].
    touch : bool
        Whether with the Touch X's resolution and friction.
    found : list of SimulatedKMax
        One for each gain of the setting; shorter after an interruption.
    linear : list of float or None
        K_max of the linear loop by pole radius [N/m].
    """

    law: str
    delay: float
    touch: bool
    found: list[SimulatedKMax]
    linear: list[float | None]


def published(setting: Setting) -> dict[str, Family]:
    """Give the derivative part of every PD and of the paper's optimum as functions of B."""
    period, step = setting.period, setting.resolution
    return {
        "pd": lambda gain: without_spring(PD(stiffness=1.0, damping=gain), period),
        "pd_filtered": lambda gain: without_spring(PDFiltered(stiffness=1.0, damping=gain, cutoff=CUTOFF), period),
        "pd_windowed": lambda gain: without_spring(PDWindowed(stiffness=1.0, damping=gain, resolution=step), period),
        "paper_optimum": lambda gain: without_spring(parse_law({"kind": "paper_optimum", "damping": gain}), period),
    }


def families(setting: Setting, delay: float) -> dict[str, Family]:
    """Give the derivative part of each law as a function of B."""
    built = published(setting)
    for name, demand in demands(setting, delay).items():
        tuned = _designed(demand)
        if tuned is not None:
            taps = tuned.taps.tolist()
            damping = -setting.period * sum(m * tap for m, tap in enumerate(taps))
            derivative = with_spring(CompiledLaw(tuple(taps)), -tuned.h1_n_per_m)
            if damping > 0.0:
                built[name] = partial(_scaled, derivative, damping)
    return built


def demands(setting: Setting, delay: float) -> dict[str, Demand]:
    """Say what the two designed laws are designed for."""
    mass, damping, period = setting.mass, setting.damping, setting.period
    delays = (delay, delay)
    return {
        # Half to twice the mass, an allowance for the hand that holds it, and what `study design` takes by default.
        "designed": Demand((0.5 * mass, 2.0 * mass), damping, delays, period, 0.99, 1e4),
        # This mass and this convention alone; 0.995 per tick still settles within the horizon, |H(−1)| is PD's at its best.
        "designed_drop": Demand(
            (mass, mass), damping, delays, period, 0.995, 4.0 * mass / period**2, lands=CONVENTIONS[:1]
        ),
    }


@functools.cache
def _designed(demand: Demand) -> Robust | None:
    import numpy as np

    from sim.design.robust import stiffest

    return stiffest(demand, np.eye(4))


def _scaled(derivative: CompiledLaw, damping: float, gain: float) -> CompiledLaw:
    return CompiledLaw(tuple(tap * gain / damping for tap in derivative.taps))


def _spring_on(derivative: CompiledLaw) -> Family:
    return lambda stiffness: with_spring(derivative, stiffness)


def boundaries(setting: Setting, step: Step) -> tuple[list[Curve], bool]:
    """Find all boundaries of the figure."""
    curves: list[Curve] = []
    try:
        _fill(curves, setting, step)
    except KeyboardInterrupt:
        return curves, False
    return curves, True


def _fill(curves: list[Curve], setting: Setting, step: Step) -> None:
    for delay in DELAYS:
        for name, family in families(setting, delay).items():
            derivatives = [family(gain) for gain in setting.gains]
            # A law with code of its own has no poles.
            linear = [None if d.evaluate else k_max(d, setting.held(delay)).k_max_n_per_m for d in derivatives]
            for touch in (False, True):
                scene = drop_scene(setting.device(delay, touch), setting.period, *CONVENTIONS[0])
                laws = [_spring_on(d) for d in derivatives]
                try:
                    found = simulated_boundary(laws, scene, setting.criterion, step=step)
                except SearchInterrupted as interrupt:
                    curves.append(Curve(name, delay, touch, interrupt.found, linear[: len(interrupt.found)]))
                    raise
                curves.append(Curve(name, delay, touch, found, linear))


def steps() -> int:
    """Count the boundaries of the figure and of the conventions, in curves."""
    return 2 * len(LAWS) * len(DELAYS) + 2 * (len(CONVENTIONS) - 1)


def spread_of_conventions(setting: Setting, curves: list[Curve], step: Step) -> list[tuple[float, str, float]]:
    """How much the conventions of contact move K_max, d = 0, perfect sensor."""
    spreads = []
    for name in ("pd", "paper_optimum"):
        family = published(setting)[name]
        first = next(c for c in curves if c.law == name and c.delay == 0.0 and not c.touch)
        columns = [first.found]
        for raw, clamp in CONVENTIONS[1:]:
            scene = drop_scene(setting.device(0.0, False), setting.period, raw, clamp)
            laws = [_spring_on(family(gain)) for gain in setting.gains]
            columns.append(simulated_boundary(laws, scene, setting.criterion, step=step))
        for gain, *row in zip(setting.gains, *columns, strict=False):
            values = [f.k_max_n_per_m for f in row if f.k_max_n_per_m is not None]
            if len(values) == len(CONVENTIONS):
                spreads.append((1.0 - min(values) / max(values), name, gain))
    return spreads


def best(curve: Curve, felt: bool) -> tuple[float, int]:
    """Stiffest point of a boundary."""
    top = (0.0, -1)
    for i, found in enumerate(curve.found):
        value = found.h1_max_n_per_m if felt else found.k_max_n_per_m
        if value is not None and math.isfinite(value):
            top = max(top, (value, i))
    return top


def as_json(setting: Setting, curves: list[Curve]) -> dict[str, Any]:
    """Prepare the boundaries for JSON."""

    def finite(value: float | None) -> float | None:
        return value if value is not None and math.isfinite(value) else None

    return {
        "mass_kg": setting.mass,
        "damping_n_s_per_m": setting.damping,
        "period_s": setting.period,
        "horizon_ticks": setting.criterion.ticks,
        "tolerance_m": setting.criterion.tolerance,
        "history": "penetration",
        "clamp": True,
        "touch_resolution_m": setting.resolution,
        "touch_friction_n": setting.friction,
        "gain_n_s_per_m": list(setting.gains),
        "curves": [
            {
                "law": curve.law,
                "delay_ticks": curve.delay,
                "touch": curve.touch,
                "k_max_n_per_m": [finite(f.k_max_n_per_m) for f in curve.found],
                "h1_max_n_per_m": [finite(f.h1_max_n_per_m) for f in curve.found],
                "frequency_hz": [f.frequency_hz for f in curve.found],
                "k_max_linear_n_per_m": [finite(value) for value in curve.linear],
            }
            for curve in curves
        ],
    }
