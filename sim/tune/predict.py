"""What a designed law will do on the device as identified: its edge by poles and by knocks, drops, delays, rest."""

from __future__ import annotations

import math
from typing import Any

from nodes.laws import CompiledLaw
from nodes.stability.closed_loop import pole_radius
from nodes.stability.flexible import FlexiblePlant, flexible_radius
from nodes.stability.plant import Plant
from nodes.stability.rest import rest
from sim.design.demand import Demand
from sim.design.families import certificate, latest_delay
from sim.design.landing import drops
from sim.identify.identified import Identified
from sim.tune.design import model
from sim.tune.knocking import KnockedEdge, Plan, knocked, planned, scaled


def plant_of(found: Identified) -> Plant:
    """Put the identified device into a plant.

    Returns: with the whole delay of the loop.
    """
    values = (found.mass.known()[0], found.damping.known()[0], found.delay.known()[0])
    return Plant(found.period, *values, found.stiffness.value or 0.0)


def knock_size(taps: tuple[float, ...], edge: float, found: Identified, peak: float | None) -> float:
    """Choose a knock that the encoder sees well and the driver does not limit.

    Returns: at most 1 mm, at least eight encoder steps [m].
    """
    strongest = 0.8 * (peak or 4.0) / (edge * max(map(abs, taps)))
    return max(min(1e-3, strongest), 8.0 * (found.encoder.value or 1e-6))


def linear_edge(law: CompiledLaw, plant: Plant | FlexiblePlant, period: float | None = None) -> float:
    """Find the factor of all taps at which a pole of the loop reaches the unit circle.

    Returns: above 1, at most 100; 1 for a law that is not stable itself.
    """

    def radius(factor: float) -> float:
        if isinstance(plant, Plant):
            return pole_radius(scaled(law, factor), plant)
        return flexible_radius(scaled(law, factor), period or math.nan, plant)

    low, high = 1.0, 1.0
    while high < 100.0 and radius(high) < 1.0:
        low, high = high, high * 1.1
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if radius(middle) < 1.0 else (low, middle)
    return low


def predict(
    law: CompiledLaw, asked: Demand, found: Identified, peak: float | None, slew: float | None
) -> tuple[dict[str, Any], KnockedEdge, Plan]:
    """Tell what a law will do on the identified device.

    `peak`, `slew`: limits of the driver: force [N], change per tick [N]. Returns: figures; the knocks on the model; the steps
    to be tried for real. Raises ValueError when the law does not come to rest on the model.
    """
    plant = plant_of(found)
    whole = found.plant()
    rigid = whole.rigid and whole.lag == 0.0
    linear = linear_edge(law, plant) if rigid else linear_edge(law, whole, found.period)
    knock = knock_size(law.taps, linear, found, peak)
    plan, edge = planned(knocked(law, model(found), found.period, knock, peak, slew), linear)
    dropped = drops(law, asked)
    factor = edge.factor
    figures: dict[str, Any] = {
        "h1_n_per_m": law.h1,
        "h_nyquist_n_per_m": law.h_nyquist,
        "pole_radius": pole_radius(law, plant) if rigid else flexible_radius(law, found.period, whole),
        "edge_linear_factor": linear,
        "edge_linear_h1_n_per_m": linear * law.h1,
        "edge_factor": factor,
        "edge_h1_n_per_m": None if factor is None else factor * law.h1,
        "knock_m": knock,
        "stable_up_to_delay_ticks": latest_delay(law, asked),
        "drops_settled": sum(dropped.values()),
        "drops": len(dropped),
        **_every_delay(law, asked),
        **_at_rest(law, found, plant),
    }
    return figures, edge, plan


def _every_delay(law: CompiledLaw, asked: Demand) -> dict[str, Any]:
    """Certify the law for every sequence of delays, where the range is within a tick."""
    low, high = asked.delay
    answer = certificate(law, asked)
    if answer == "too wide":
        why = f"delays of {low:.3g} to {high:.3g} ticks: over a tick apart"
        return {"every_delay_stable": None, "every_delay_why": why}
    return {"every_delay_stable": answer}


def _at_rest(law: CompiledLaw, found: Identified, plant: Plant) -> dict[str, Any]:
    """Compare the friction with what rest takes: a proof where it is above the bound, an estimate below."""
    if found.encoder.value is None or found.friction.value is None:
        return {"limit_cycle_free": None}
    answer = rest(law, plant, found.encoder.value)
    friction = found.friction.value
    return {
        "friction_n": friction,
        "friction_for_rest_bound_n": answer.friction_bound_n,
        "friction_for_rest_estimated_n": answer.friction_estimated_n,
        "limit_cycle_free": answer.free(friction),
        "buzz_hz": answer.buzz_hz,
    }
