"""The map's limit: just inside it the loop is stable, just outside unstable."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import pytest

from nodes.coupling.parameters import PlantParameters
from nodes.laws.parse import parse_law
from nodes.stability.closed_loop import pole_radius
from nodes.stability.k_max import without_spring
from nodes.stability.plant import Plant
from nodes.stability.worlds import EulerTool, SteppedTool, world_k_max
from nodes.view.stability_map import (
    drawn_map,
    plant_of,
    stability_map,
    with_inertia,
    with_moving_worlds,
)
from tests.support import thoroughly

T = 0.002
PLANT = PlantParameters(mass=0.1, damping=1.0)
LAWS: list[dict[str, Any]] = [
    {"kind": "pd", "stiffness": 1000.0, "damping": 3.0},
    {
        "kind": "pd_alpha",
        "stiffness": 1000.0,
        "damping": 3.0,
        "order": 1.2,
        "taps": 10,
        "gains": "paper",
    },
    {"kind": "paper_optimum"},
]


def radius(described: dict[str, Any], delay: float, **changed: float) -> float:
    law = msgspec.structs.replace(parse_law(described), **changed)
    return pole_radius(
        law.compile(T), Plant(T, PLANT.mass, PLANT.damping, delay, PLANT.stiffness)
    )


def whole_map(law: Any, plant: PlantParameters) -> dict[str, Any]:
    """Return a map without delay, with the limits for moving worlds."""
    return with_moving_worlds(stability_map(law, T, plant, 0.0), law, T, plant, 0.0)


@pytest.mark.parametrize(
    "delay",
    thoroughly([0.0, 0.3, 1.0], "test_inside_is_stable_and_outside_is_not", but=[0.3]),
)
@pytest.mark.parametrize("described", LAWS, ids=lambda law: law["kind"])
def test_inside_is_stable_and_outside_is_not(
    described: dict[str, Any], delay: float
) -> None:
    found = stability_map(parse_law(described), T, PLANT, delay)
    rows = [row for row in found["edge"] if row[1] is not None]
    assert len(rows) > 40
    for b, _, high in rows[::7]:
        # One part in 10⁶ is far beyond the edge's own rounding, 1e-9 of K.
        assert radius(described, delay, stiffness=high * (1.0 - 1e-6), damping=b) < 1.0
        assert radius(described, delay, stiffness=high * (1.0 + 1e-6), damping=b) > 1.0
    margin = found["delay_margin_ticks"]
    assert (margin == 0.0) == (radius(described, delay) >= 1.0)
    assert radius(described, delay + margin + 1e-6) > 1.0
    assert margin == 0.0 or radius(described, delay + margin - 1e-6) < 1.0
    assert found["k_max_n_per_m"] == pytest.approx(
        next(high for b, _, high in rows if b == found["b_n_s_per_m"]), rel=1e-9
    )


def test_the_edge_for_any_world_lies_below_that_of_a_wall() -> None:
    found = whole_map(parse_law(LAWS[0]), PLANT)
    # THEORY.md §18
    assert found["k_max_any_world_n_per_m"] == pytest.approx(2244.217, abs=1e-3)
    walls = {b: high for b, _, high in found["edge"]}
    shared = [(k, walls[b]) for b, k in found["any_world"] if b in walls]
    assert len(shared) > 2
    assert all(k < wall for k, wall in shared)
    # Without a damper a wall is the worst world, where the product of the two poles is 1; the
    # certificate stays a few millionths below.
    decay = math.exp(-PLANT.damping * T / PLANT.mass)
    limit = (1.0 - decay) / (PLANT.mass * (1.0 - decay) - T * decay)
    gain, edge = found["any_world"][0]
    assert gain == 0.0
    assert limit * (1.0 - 1e-5) < edge <= limit
    assert found["any_world_over_delay"][0] == [0.0, found["k_max_any_world_n_per_m"]]
    over = [k for _, k in found["any_world_over_delay"]]
    assert over == sorted(over, reverse=True)
    assert "same tick" in found["world"]


def test_the_edge_of_a_stepped_tool_is_that_of_its_damping() -> None:
    """Its damping counts, not its mass; two devices on one law have no such line."""
    spring = parse_law({"kind": "pd", "stiffness": 100.0, "damping": 0.0})
    held = msgspec.structs.replace(PLANT, tool_mass=0.02, tool_damping=1.0)
    found = whole_map(spring, held)
    assert "stepped tool" in found["world"]
    derivative = without_spring(spring, T)
    edge = world_k_max(derivative, Plant(T, 0.1, 1.0), SteppedTool(1.0)).k_max_n_per_m
    assert found["k_max_any_world_n_per_m"] == edge
    loose = whole_map(spring, msgspec.structs.replace(held, tool_damping=0.0))
    assert loose["k_max_any_world_n_per_m"] is None
    # Where all behind it is solved within the step, its weight counts as well.
    heavy = msgspec.structs.replace(held, tool_damping=0.0, tool_step=T / 2)
    found = whole_map(spring, heavy)
    edge = world_k_max(derivative, Plant(T, 0.1, 1.0), EulerTool(0.02, 2)).k_max_n_per_m
    assert edge is not None
    assert found["k_max_any_world_n_per_m"] == edge
    assert "2 steps of semi-implicit Euler" in found["world"]
    assert "any_world" not in whole_map(
        spring, msgspec.structs.replace(PLANT, partner_mass=0.1)
    )


def test_the_map_follows_law_device_and_delay() -> None:
    pd = parse_law(LAWS[0])
    plain = stability_map(pd, T, PLANT, 0.0)
    # The closed form of the README: 3781.866 N/m without delay.
    assert plain["k_max_n_per_m"] == pytest.approx(3781.866, abs=1e-3)
    assert stability_map(pd, T, PLANT, 1.0)["k_max_n_per_m"] < 1300.0
    assert (
        stability_map(pd, T, PlantParameters(mass=0.1, damping=1.0, delay=1.0), 0.0)[
            "delay_ticks"
        ]
        == 1.0
    )
    assert (
        stability_map(pd, T, PlantParameters(mass=0.2, damping=1.0), 0.0)[
            "k_max_n_per_m"
        ]
        != plain["k_max_n_per_m"]
    )
    assert not stability_map(
        parse_law({**LAWS[0], "stiffness": 3800.0}), T, PLANT, 0.0
    )["stable"]
    assert stability_map(parse_law({**LAWS[0], "stiffness": 3700.0}), T, PLANT, 0.0)[
        "stable"
    ]


@pytest.mark.slow
def test_with_a_mass_that_depends_on_the_place_the_worst_is_drawn() -> None:
    pd = parse_law(LAWS[0])
    edges = {
        mass: stability_map(pd, T, PlantParameters(mass=mass, damping=1.0), 1.0)[
            "k_max_n_per_m"
        ]
        for mass in (0.05, 0.1, 0.4)
    }
    for light, heavy in ((0.05, 0.1), (0.1, 0.4), (0.05, 0.4)):
        found = stability_map(
            pd, T, PlantParameters(mass=light, heaviest=heavy, damping=1.0), 1.0
        )
        assert found["k_max_n_per_m"] == min(edges[light], edges[heavy])
        assert edges[found["mass_kg"]] == found["k_max_n_per_m"]


def test_what_a_device_says_of_its_masses_goes_into_the_map() -> None:
    seen = {"here_kg": [0.15, 0.1, 0.1], "least_kg": 0.08, "greatest_kg": 0.2}
    declared = PlantParameters(mass=0.1, damping=1.0)
    assert with_inertia(None, None) is None
    assert with_inertia(declared, None) == declared
    assert with_inertia(None, seen) == PlantParameters(mass=0.08, heaviest=0.2)
    assert with_inertia(declared, seen) == PlantParameters(
        mass=0.08, heaviest=0.2, damping=1.0
    )
    # What the device tells is as the scene moves it, at a scale of two a quarter of its own mass.
    larger = PlantParameters(mass=0.4, damping=1.0, scale=2.0)
    assert with_inertia(larger, seen) == PlantParameters(
        mass=0.32, heaviest=0.8, damping=1.0, scale=2.0
    )
    # A hand makes the declared one heavier than the device by itself.
    held = PlantParameters(mass=0.05, heaviest=0.5, damping=1.0)
    assert with_inertia(held, seen) == held
    drawn = drawn_map(LAWS[0], T, {"mass": 0.1, "damping": 1.0}, {}, 0.5, seen)
    assert drawn["plant"]["heaviest"] == 0.2
    assert drawn["mass_kg"] in (0.08, 0.2)


def test_a_law_without_k_and_b_has_margins_only_and_an_unknown_device_has_none() -> (
    None
):
    found = drawn_map(
        {"kind": "designed_d0"}, T, {"mass": 0.1, "damping": 1.0}, {}, 0.1
    )
    assert "edge" not in found
    assert found["stable"]
    assert found["delay_margin_ticks"] > 0.0
    assert "plant: {mass" in drawn_map(LAWS[0], T, None, {}, 0.0)["why"]
    assert "H(1)" in drawn_map(
        {**LAWS[2], "stiffness": 1.0}, T, {"mass": 0.1}, {}, 0.0
    ).get("why", "H(1)")


def test_what_cannot_be_drawn_is_said() -> None:
    """After an unexpected error the previous law's map stayed."""
    for law, declared in (
        ({**LAWS[0], "damping": 1e308}, {"mass": 0.1}),
        (LAWS[0], {"mass": "heavy"}),
    ):
        assert drawn_map(law, T, declared, {}, 0.0)["why"].startswith("No map: ")


def test_a_virtual_device_stands_in_for_what_is_not_declared() -> None:
    device = {
        "mass": 0.1,
        "damping": 1.0,
        "delay": 0.5,
        "hand": {"mass": 0.05, "damping": 2.0, "stiffness": 150.0},
    }
    plant = plant_of(None, {"device": device})
    assert plant == PlantParameters(
        mass=0.1 + 0.05, damping=3.0, stiffness=150.0, device_delay=0.5
    )
    # The device's own delay comes on top of what the loop measures.
    assert stability_map(parse_law(LAWS[0]), T, plant, 0.25)["delay_ticks"] == 0.75
    assert plant_of({"mass": 0.2}, {"device": device}) == PlantParameters(mass=0.2)
    assert plant_of(None, {"device": "touch_x"}) is None
