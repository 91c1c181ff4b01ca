"""The paper's figure 4: the largest stiffness that survives the drop, over the damping gain B, law by law.

The same drop for PD, the paper's optimum and a law designed for the same device and delay: at no delay and at one tick, with a
perfect sensor and with the Touch X's (resolution and friction, which only matter together). Stiffness is told twice,
nominal K and H(1), what is felt; and the frequency at which the device really swings at the limit is measured.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from nodes.laws import CompiledLaw
from nodes.laws.parse import parse_law
from nodes.laws.pd import PD
from nodes.stability.k_max import Plant, k_max, with_spring, without_spring
from sim.device.model import DeviceModel
from sim.experiments.drop import Criterion, drop_scene
from sim.experiments.k_max_simulated import SearchInterrupted, SimulatedKMax, simulated_boundary

Step = Callable[[str, int], None]
Family = Callable[[float], CompiledLaw]

LAWS = ("pd", "paper_optimum", "designed")
DELAYS = (0.0, 1.0)
CONVENTIONS = ((False, True), (False, False), (True, True), (True, False))
"""(raw, clamp): which history, and whether forces into the floor are set to zero."""


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
        return Plant(self.mass, self.damping, delay)


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
    """Give the derivative part of PD and of the paper's optimum as functions of B."""
    period = setting.period
    return {
        "pd": lambda gain: without_spring(PD(stiffness=1.0, damping=gain), period),
        "paper_optimum": lambda gain: without_spring(parse_law({"kind": "paper_optimum", "damping": gain}), period),
    }


def families(setting: Setting, delay: float) -> dict[str, Family]:
    """Give the derivative part of each law as a function of B."""
    from sim.design.families import designed
    from sim.design.robust import Demand

    built = published(setting)
    # Half to twice the mass, an allowance for the hand that holds it, and what `study design` takes by default.
    demand = Demand(
        (0.5 * setting.mass, 2.0 * setting.mass), setting.damping, (delay, delay), setting.period, 0.99, 1e4
    )
    tuned = designed(demand, 4).found
    if tuned is not None:
        taps = tuned.taps.tolist()
        damping = -setting.period * sum(m * tap for m, tap in enumerate(taps))
        derivative = with_spring(CompiledLaw(tuple(taps)), -tuned.h1_n_per_m)
        if damping > 0.0:
            built["designed"] = lambda gain: CompiledLaw(tuple(tap * gain / damping for tap in derivative.taps))
    return built


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
            device = Plant(setting.mass, setting.damping, delay)
            linear = [k_max(d, setting.period, device).k_max_n_per_m for d in derivatives]
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
