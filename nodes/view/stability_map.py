"""Stability map beside the sliders: stable K and B of the active law, and its margins.

Computed with the project's exact methods (sim/THEORY.md §3), for the declared device and the
measured delay. It runs in the view's process, off the chain's core: a map takes 0.1 s, the limits
for moving worlds 0.4 s more, so they are added point by point when the page rests
(`moving_worlds`).
"""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import msgspec
import numpy as np

from messages.errors import HapticError
from nodes.coupling.parameters import PlantParameters
from nodes.laws import Law
from nodes.laws.parse import parse_law
from nodes.stability.closed_loop import pole_radius
from nodes.stability.judge import last_inside
from nodes.stability.k_max import without_spring
from nodes.stability.plant import Plant
from nodes.stability.worlds import (
    AnyWorld,
    EulerTool,
    SteppedTool,
    WorldKind,
    world_k_max,
)
from nodes.view.law_edges import edge_of_law, stable_interval

NEAR, FAR = (
    33,
    24,
)  # points of the edge: evenly spaced around the gain, then geometrically
FARTHEST = 4096.0  # search limit of the far end, relative to the near part
DELAY_LIMIT = 20.0  # search limit of the delay margin [ticks]
DELAYS = 25  # points of the edge over the delay
# Points of the edge for any world, over the gain and over the delay; 8 ms each.
ANY_NEAR, ANY_DELAYS = 13, 9


def plant_of(declared: Any, driver: Mapping[str, Any]) -> PlantParameters | None:
    """Return the device that a map is drawn for; None if it is not declared."""
    if declared is not None:
        return msgspec.convert(declared, PlantParameters)
    device = driver.get("device")
    if not isinstance(device, Mapping) or "mass" not in device:
        return None
    hand = device.get("hand") or {}
    damping = float(device.get("damping", 0.0)) + float(hand.get("damping", 0.0))
    masses = [float(mass) for _, mass in device.get("mass_by_position", ())] or [
        float(device["mass"])
    ]
    least, most = (
        end + float(hand.get("mass", 0.0)) for end in (min(masses), max(masses))
    )
    stiffness = float(hand.get("stiffness", 0.0))
    delay = float(device.get("delay", 0.0))
    return PlantParameters(
        mass=least,
        heaviest=most if most > least else None,
        damping=damping,
        stiffness=stiffness,
        device_delay=delay,
    )


def _moving(plant: PlantParameters) -> WorldKind | None:
    """Return the moving worlds of the map's dashed line; None if two devices share the law."""
    if plant.partner_mass is not None:
        return None
    stepped = plant.tool_mass is not None and plant.tool_lag != 0.0
    return SteppedTool(plant.tool_damping) if stepped else AnyWorld()


def same_tick_worlds(plant: PlantParameters | None) -> str:
    """Return the words for worlds that answer in the same tick; "" if others meet the law."""
    world = None if plant is None else _moving(plant)
    return world.about if isinstance(world, AnyWorld) else ""


def _heavy(plant: PlantParameters, device: Plant) -> EulerTool | None:
    """Return the tool of known mass, or None if its steps are not known."""
    steps = plant.tool_steps(device.period)
    if plant.tool_mass is None or steps is None:
        return None
    late = plant.delay_before_device(device)
    return EulerTool(plant.tool_mass, steps, plant.tool_damping, late)


def _certified(
    law: Law, devices: Sequence[Plant], world: WorldKind, plant: PlantParameters
) -> float | None:
    """Return the largest K certified on all devices for moving worlds (THEORY.md §18)."""
    least = math.inf
    for device in devices:
        heavy = _heavy(plant, device) if isinstance(world, SteppedTool) else None
        edges = [
            world_k_max(without_spring(law, device.period), device, kind).k_max_n_per_m
            for kind in (world, heavy)
            if kind is not None
        ]
        certified = [edge for edge in edges if edge is not None]
        if not certified:
            return None
        least = min(least, max(certified))
    return least if math.isfinite(least) else None


def _at(law: Law, damping: float) -> Law:
    return msgspec.structs.replace(law, damping=damping)


def _bounds(
    law: Law, devices: Sequence[Plant], dampings: list[float]
) -> list[list[float | None]]:
    found: list[list[float | None]] = []
    for damping in dampings:
        low, high = stable_interval(_at(law, damping), devices) or (None, None)
        found.append(
            [damping, low, high if high is None or math.isfinite(high) else None]
        )
    return found


def _end(law: Law, devices: Sequence[Plant], near: float) -> float:
    """Return the largest B with any stable K, searched from `near` to `near` · FARTHEST."""
    inside = near
    while inside < near * FARTHEST:
        outside = 2.0 * inside
        if stable_interval(_at(law, outside), devices) is None:
            return last_inside(
                lambda damping: stable_interval(_at(law, damping), devices) is not None,
                inside,
                outside,
                10,
            )
        inside = outside
    return inside


def delay_margin(law: Law, devices: Sequence[Plant]) -> float | None:
    """Return the extra delay at which the loop becomes unstable with a device [ticks]."""
    compiled = law.compile(devices[0].period)
    begin = devices[0].delay

    def stable(delay: float) -> bool:
        return all(
            pole_radius(compiled, replace(device, delay=delay)) < 1.0
            for device in devices
        )

    if not stable(begin):
        return 0.0
    inside = begin
    for delay in np.arange(1, round(DELAY_LIMIT / 0.1) + 1) * 0.1 + begin:
        if not stable(float(delay)):
            return last_inside(stable, inside, float(delay), 30) - begin
        inside = float(delay)
    return None


def _over_delay(
    law: Law, devices: Sequence[Plant], margin: float | None
) -> list[list[float | None]]:
    """Return rows of delay, smallest and largest stable K, to beyond the present margin."""
    meets = devices[0].delay + (DELAY_LIMIT if margin is None else margin)
    # A power of two, as for B.
    far = min(DELAY_LIMIT, 2.0 ** math.ceil(math.log2(max(1.1 * meets, 2.0))))
    found: list[list[float | None]] = []
    for delay in np.linspace(0.0, far, DELAYS).tolist():
        late = [replace(device, delay=delay) for device in devices]
        (row,) = _bounds(law, late, [law.damping])  # type: ignore[attr-defined]
        found.append([delay, *row[1:]])
    return found


def with_inertia(
    declared: PlantParameters | None, seen: Mapping[str, Any] | None
) -> PlantParameters | None:
    """Return the plant with the masses that a device reports for its poses, without the hand.

    The device reports the mass that the scene moves; the plant's own masses are those times the
    square of the scale.
    """
    if seen is None:
        return declared
    least = float(seen["least_kg"])
    greatest = float(seen["greatest_kg"])
    if declared is None:
        return PlantParameters(mass=least, heaviest=greatest)
    least = least * declared.scale**2
    greatest = greatest * declared.scale**2
    return msgspec.structs.replace(
        declared,
        mass=min(declared.mass, least),
        heaviest=max(declared.heaviest or declared.mass, greatest),
    )


def stability_map(
    law: Law, period: float, plant: PlantParameters, delay: float
) -> dict[str, Any]:
    """Compute the stable region of the (B, K) plane for every mass of the device."""
    compiled = law.compile(period)
    if compiled.evaluate is not None:
        raise ValueError("the law has code beside its taps, so it has no poles.")
    devices = plant.over_workspace(period, delay)
    radii = [pole_radius(compiled, device) for device in devices]
    ends = [stable_interval(law, [device]) for device in devices]
    # The worst mass: unstable before stable, then by the lowest edge.
    worst = max(
        range(len(devices)),
        key=lambda i: (radii[i] >= 1.0, -(0.0 if (end := ends[i]) is None else end[1])),
    )
    radius = max(radii)
    k = float(getattr(law, "stiffness", compiled.h1))
    found: dict[str, Any] = {
        "delay_ticks": devices[0].delay,
        "plant": msgspec.to_builtins(plant),
        "mass_kg": plant.masses[worst],
        "pole_radius": radius,
        "stable": radius < 1.0,
        "k_n_per_m": k,
        "k_max_n_per_m": edge_of_law(law, devices),
        "delay_margin_ticks": delay_margin(law, devices),
    }
    b = getattr(law, "damping", None)
    if not isinstance(b, float) or not hasattr(law, "stiffness"):
        return found
    # A power of two, so that the axis stays fixed while a slider moves within it.
    near = 2.0 ** math.ceil(math.log2(max(2.0 * b, plant.damping, 1e-3)))
    rows = _bounds(law, devices, np.linspace(0.0, near, NEAR).tolist())
    end = _end(law, devices, near)
    if end > near:
        rows += _bounds(law, devices, np.geomspace(near, end, FAR)[1:].tolist())
    over = _over_delay(law, devices, found["delay_margin_ticks"])
    return found | {"b_n_s_per_m": b, "near": near, "edge": rows, "over_delay": over}


def with_moving_worlds(
    found: dict[str, Any], law: Law, period: float, plant: PlantParameters, delay: float
) -> dict[str, Any]:
    """Return a map with the limits for moving worlds; the same map where it has no plane."""
    points = moving_worlds(found, law, period, plant, delay)
    while True:
        try:
            next(points)
        except StopIteration as done:
            whole: dict[str, Any] = done.value
            return whole


def moving_worlds(
    found: dict[str, Any], law: Law, period: float, plant: PlantParameters, delay: float
) -> Generator[None, None, dict[str, Any]]:
    """Compute `with_moving_worlds` a point at a time (16 ms each); the map is what it returns."""
    world = _moving(plant)
    if world is None or "edge" not in found:
        return found
    devices = plant.over_workspace(period, delay)
    near = found["near"]
    over = found["over_delay"]
    worst = plant.masses.index(found["mass_kg"])
    # The device alone: the tool coupled to it is part of the world.
    some = [
        replace(devices[i], partner=None) for i in sorted({0, worst, len(devices) - 1})
    ]
    gains = np.linspace(0.0, near, ANY_NEAR).tolist()
    # The limit falls fastest at small delays.
    delays = ((over[-1][0] or 0.0) * np.linspace(0.0, 1.0, ANY_DELAYS) ** 2).tolist()
    heavy = _heavy(plant, some[0]) if isinstance(world, SteppedTool) else None
    about = world.about if heavy is None else f"{world.about}, or {heavy.about}"
    here = _certified(law, some, world, plant)
    over_gains: list[list[float | None]] = []
    for gain in gains:
        yield
        over_gains.append([gain, _certified(_at(law, gain), some, world, plant)])
    over_delays: list[list[float | None]] = []
    for later in delays:
        yield
        late = [replace(device, delay=later) for device in some]
        over_delays.append([later, _certified(law, late, world, plant)])
    return found | {
        "world": about,
        "stepped": isinstance(world, SteppedTool),
        "k_max_any_world_n_per_m": here,
        "any_world": over_gains,
        "any_world_over_delay": over_delays,
    }


def map_in_steps(
    described: Mapping[str, Any],
    period: float,
    declared: Any,
    driver: Mapping[str, Any],
    delay: float,
    inertia: Mapping[str, Any] | None = None,
) -> Iterator[dict[str, Any] | None]:
    """Compute the map for a page in steps, or why there is none.

    First comes the plane of the law (0.1 s), then None per further point (16 ms), at last the map
    with the limits for moving worlds. `inertia` holds the device's masses.
    """
    try:
        plant = with_inertia(plant_of(declared, driver), inertia)
        if plant is None:
            yield {
                "why": (
                    "No map: the device is not declared. Set plant of the coupling in the launch"
                    " file, for example plant: {mass: 0.1, damping: 1.0}."
                )
            }
            return
        law = parse_law(described, "law")
        found = stability_map(law, period, plant, delay)
        yield found
        whole = yield from moving_worlds(found, law, period, plant, delay)
        if whole is not found:
            yield whole
    except (HapticError, ValueError, ArithmeticError, msgspec.ValidationError) as error:
        yield {"why": f"No map: {error}"}


def drawn_map(*inputs: Any) -> dict[str, Any]:
    """Return the map of `map_in_steps` at once."""
    *_, found = filter(None, map_in_steps(*inputs))
    return found
