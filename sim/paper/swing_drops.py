"""How often the interval of a swing holds K_max: random devices with friction and an encoder, dropped (THEORY.md §9)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from nodes.laws.parse import parse_law
from nodes.stability.k_max import k_max, without_spring
from nodes.stability.plant import Plant
from sim.device.model import DeviceModel
from sim.experiments.drop import drop_scene
from sim.paper.swing import CannotTellError, longest, swing_of
from sim.scene.loop import run

TICKS = 500
"""Of a drop."""
RESOLUTION = 2.3e-5
"""Of the encoder [m]."""


def dropped(number: int, name: str, law: Mapping[str, Any], period: float) -> dict[str, Any]:
    """Drop a random device on a floor of 0.3 to 0.9 K_max, and look for K_max in its swing.

    50 to 320 g, 0.5 to 2 N s/m, friction up to 0.1 N, a delay of up to 1.5 ticks; B is 20 to 60 times the mass.
    """
    random = np.random.default_rng([7, number])
    plant = Plant(period, 10.0 ** random.uniform(-1.3, -0.5), random.uniform(0.5, 2.0), random.uniform(0.0, 1.5))
    gained = {**law, "damping": random.uniform(20.0, 60.0) * plant.mass}
    share, friction = random.uniform(0.3, 0.9), random.uniform(0.0, 0.1)
    limit = k_max(without_spring(parse_law(gained), period), plant).k_max_n_per_m
    result: dict[str, Any] = {"law": name, "share": share, "k_max_n_per_m": limit, "between_n_per_m": None}
    if limit is None:
        return result | {"why": "no stiffness is stable"}
    rendered = parse_law({**gained, "stiffness": share * limit})
    device = DeviceModel(
        mass=plant.mass, damping=plant.damping, delay=plant.delay, friction=friction, resolution=RESOLUTION
    )
    trace = run(drop_scene(device, period, raw=False, clamp=True), rendered.compile(period), TICKS)
    first, last = longest(np.abs(trace.force) > 0.0)
    try:
        swing = swing_of(rendered, plant, trace.measured[first:last], plant.damping)
    except CannotTellError as error:
        return result | {"why": str(error)}
    return result | {"between_n_per_m": list(swing.k_max_n_per_m), "why": ""}


def counted(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Count over many drops: refusals, intervals that hold K_max, and by how much the others miss it."""
    result = [row for row in rows if row["between_n_per_m"]]
    misses = []
    for row in result:
        (low, high), limit = row["between_n_per_m"], row["k_max_n_per_m"]
        misses.append(max(low / limit - 1.0, 1.0 - high / limit, 0.0))
    widths = [(row["between_n_per_m"][1] - row["between_n_per_m"][0]) / row["k_max_n_per_m"] for row in result]
    return {
        "drops": len(rows),
        "told": len(result),
        "hold": sum(miss == 0.0 for miss in misses),
        "worst_miss": max(misses, default=None),
        "median_width": float(np.median(widths)) if widths else None,
    }
