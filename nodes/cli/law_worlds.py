"""The stiffness of a law for worlds that move, beside the figures of ``haptic law show``: computed here, not in the loop."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

ROWS = (
    ("k_max_wall_n_per_m", "K_max on a wall"),
    ("k_max_any_world_n_per_m", "K_max with any implicit world (known device)"),
    ("k_max_any_hand_any_world_n_per_m", "K_max with any implicit world in any hand"),
)


def world_figures(shown: Mapping[str, Any]) -> dict[str, Any]:
    """Return K_max for a wall, any implicit world, and any hand as well; empty where device or law do not allow it.

    `shown`: figures of a law with ``kind`` and its parameters, ``plant``, ``rate_hz`` and
    ``delay_ticks``. Where the mass depends on the position: the least over both ends and the worst.
    """
    from nodes.laws import load_law
    from nodes.laws.parse import parse_law
    from nodes.stability.k_max import without_spring
    from nodes.stability.plant import Plant
    from nodes.stability.world_limits import finite, world_limits

    plant = shown.get("plant")
    if not plant or shown.get("pole_radius") is None:
        return {}
    fields = load_law(shown["kind"]).__struct_fields__
    law = parse_law({"kind": shown["kind"], **{name: shown[name] for name in fields if name in shown}})
    period = 1.0 / shown["rate_hz"]
    derivative = without_spring(law, period)
    masses = {plant["mass"], plant.get("heaviest") or plant["mass"], shown.get("worst_mass_kg") or plant["mass"]}
    device = Plant(period, plant["mass"], plant.get("damping", 0.0), shown["delay_ticks"], plant.get("stiffness", 0.0))
    found: dict[str, float | None] = {}
    for mass in masses:
        limits = world_limits(derivative, Plant(period, mass, device.damping, device.delay, device.stiffness))
        for name, k in limits.k_max_n_per_m.items():
            before = found.get(name, k)
            found[name] = None if k is None or before is None else min(k, before)
    return {f"k_max_{name}_n_per_m": finite(k) for name, k in found.items()}


def world_lines(figures: Mapping[str, Any], wide: int) -> list[str]:
    """Return a line for each figure of `world_figures`; `wide`: of the names [characters]."""
    return [
        f"  {label:{wide}}  {'none certified' if figures[key] is None else format(figures[key], '.6g'):>14}"
        f"{'' if figures[key] is None else ' N/m'}"
        for key, label in ROWS
        if key in figures
    ]
