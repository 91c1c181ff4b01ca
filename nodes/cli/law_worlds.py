"""K_max of a law with moving worlds, for ``haptic law show``; computed outside the loop."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import msgspec

ROWS = (
    ("k_max_wall_n_per_m", "K_max on a wall"),
    ("k_max_any_world_n_per_m", "K_max with any implicit world (known device)"),
    ("k_max_any_hand_any_world_n_per_m", "K_max with any implicit world in any hand"),
    ("k_max_two_hands_n_per_m", "K_max with the second device, any two hands"),
)


def world_figures(shown: Mapping[str, Any]) -> dict[str, Any]:
    """Return K_max for a wall, any implicit world, and any hand; empty if not computable.

    `shown` holds the figures of a law with ``kind`` and its parameters, ``plant``, ``rate_hz`` and
    ``delay_ticks``. If the mass depends on position, the result is the smallest over both ends and
    the worst mass.
    """
    from nodes.coupling.parameters import PlantParameters
    from nodes.laws import load_law
    from nodes.laws.parse import parse_law
    from nodes.stability.k_max import without_spring
    from nodes.stability.world_limits import finite, world_limits
    from nodes.stability.worlds import OtherDevice, world_k_max

    if not shown.get("plant") or shown.get("pole_radius") is None:
        return {}
    declared = msgspec.convert(shown["plant"], PlantParameters)
    fields = load_law(shown["kind"]).__struct_fields__
    law = parse_law(
        {
            "kind": shown["kind"],
            **{name: shown[name] for name in fields if name in shown},
        }
    )
    period = 1.0 / shown["rate_hz"]
    late = shown["delay_ticks"] - declared.device_delay
    derivative = without_spring(law, period)
    masses = {
        declared.mass,
        declared.heaviest or declared.mass,
        shown.get("worst_mass_kg") or declared.mass,
    }
    found: dict[str, float | None] = {}
    for mass in masses:
        loop = msgspec.structs.replace(declared, mass=mass, delay=max(late, 0.0)).at(
            period, 0.0
        )
        alone = dataclasses.replace(loop, partner=None)
        if declared.partner_mass is not None and loop.other is not None:
            other = OtherDevice(loop.other.damping, loop.other.delay)
            limits = {
                "two_hands": world_k_max(
                    derivative, alone, other, any_hand=True
                ).k_max_n_per_m
            }
        else:
            limits = dict(world_limits(derivative, alone).k_max_n_per_m)
        for name, k in limits.items():
            before = found.get(name, k)
            found[name] = None if k is None or before is None else min(k, before)
    return {f"k_max_{name}_n_per_m": finite(k) for name, k in found.items()}


def world_lines(figures: Mapping[str, Any], wide: int) -> list[str]:
    """Return a line per figure of `world_figures`; `wide` is the width of the labels."""
    return [
        f"  {label:{wide}} "
        f" {'none certified' if figures[key] is None else format(figures[key], '.6g'):>14}"
        f"{'' if figures[key] is None else ' N/m'}"
        for key, label in ROWS
        if key in figures
    ]
