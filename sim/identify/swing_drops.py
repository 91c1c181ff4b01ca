"""Coverage of the interval of K_max from a swing, by drops of random devices."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from nodes.laws.parse import parse_law
from nodes.stability.k_max import k_max, without_spring
from nodes.stability.plant import Plant
from sim.device.model import DeviceModel
from sim.experiments.drop import drop_scene
from sim.identify.swing import RESOLUTION, TICKS, CannotTellError, longest, swing_of
from sim.play.one_axis import run


@dataclass(frozen=True)
class DroppedSwing:
    """K_max of a random device, and its interval from the swing of a drop."""

    law: str
    share: float  # of K_max that was rendered
    k_max_n_per_m: float | None
    between_n_per_m: tuple[float, float] | None = None
    why: str = ""  # reason for no interval


@dataclass(frozen=True)
class SwingCount:
    """Intervals over several drops."""

    drops: int
    told: int  # drops with an interval
    hold: int  # intervals that contain K_max
    worst_miss: float | None  # largest distance of K_max from its interval, relative
    median_width: float | None  # of an interval, relative to K_max


def dropped(
    number: int, name: str, law: Mapping[str, Any], period: float
) -> DroppedSwing:
    """Drop a random device on a floor of 0.3 to 0.9 K_max and estimate K_max from its swing."""
    random = np.random.default_rng([7, number])
    plant = Plant(
        period,
        10.0 ** random.uniform(-1.3, -0.5),
        random.uniform(0.5, 2.0),
        random.uniform(0.0, 1.5),
    )
    gained = {**law, "damping": random.uniform(20.0, 60.0) * plant.mass}
    share, friction = random.uniform(0.3, 0.9), random.uniform(0.0, 0.1)
    limit = k_max(without_spring(parse_law(gained), period), plant).k_max_n_per_m
    result = DroppedSwing(name, share, limit)
    if limit is None:
        return replace(result, why="no stiffness is stable")
    rendered = parse_law({**gained, "stiffness": share * limit})
    device = DeviceModel(
        mass=plant.mass,
        damping=plant.damping,
        delay=plant.delay,
        friction=friction,
        resolution=RESOLUTION,
    )
    trace = run(
        drop_scene(device, period, raw=False, clamp=True),
        rendered.compile(period),
        TICKS,
    )
    first, last = longest(np.abs(trace.force) > 0.0)
    try:
        swing = swing_of(rendered, plant, trace.measured[first:last], plant.damping)
    except CannotTellError as error:
        return replace(result, why=str(error))
    return replace(result, between_n_per_m=swing.k_max_n_per_m)


def counted(rows: Sequence[DroppedSwing]) -> SwingCount:
    """Count refusals, intervals that contain K_max, and the misses of the others."""
    ends = [
        [end / row.k_max_n_per_m for end in row.between_n_per_m]
        for row in rows
        if row.between_n_per_m is not None and row.k_max_n_per_m is not None
    ]
    misses = [max(low - 1.0, 1.0 - high, 0.0) for low, high in ends]
    widths = [high - low for low, high in ends]
    return SwingCount(
        drops=len(rows),
        told=len(ends),
        hold=sum(miss == 0.0 for miss in misses),
        worst_miss=max(misses, default=None),
        median_width=float(np.median(widths)) if widths else None,
    )
