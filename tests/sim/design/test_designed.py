"""Designed presets keep what they promise, in the scene they were made for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from nodes.launcher import launch_file
from nodes.laws.parse import parse_law
from nodes.stability.closed_loop import pole_radius
from nodes.stability.plant import Plant
from sim.design.demand import CONVENTIONS, Demand
from sim.design.landing import dropped, drops
from sim.design.robust import stiffest
from sim.experiments.settling import Criterion, settles
from sim.play.player import play

T = 0.002
DEMANDS = {
    "designed_d0": Demand((0.05, 0.2), 1.0, (0.0, 0.5), T, 0.99, 1e4),
    "designed_d1": Demand((0.05, 0.2), 1.0, (1.0, 1.0), T, 0.99, 1e4),
}
"""Demands as stated beside the presets."""


@pytest.mark.parametrize("name", DEMANDS)
def test_preset_keeps_its_demand(name: str) -> None:
    law, demand = parse_law(name).compile(T), DEMANDS[name]
    # The preset's taps are rounded inwards: the radius that they claim is kept to the last digit.
    for mass in np.geomspace(*demand.mass, 21).tolist():
        for delay in demand.delay:
            assert (
                pole_radius(law, Plant(T, mass, demand.damping, delay)) <= demand.radius
            )
    assert abs(law.h_nyquist) <= demand.nyquist + 0.02
    assert all(drops(law, demand).values())


@pytest.mark.parametrize("name", DEMANDS)
def test_preset_lands_between_the_drops_that_it_was_designed_with_and_not_far_beyond(
    name: str,
) -> None:
    """The limit of settling is ragged; the margin keeps it outside the demanded masses."""
    law, demand = parse_law(name).compile(T), DEMANDS[name]

    def fallen(masses: list[float]) -> list[bool]:
        return [
            settles(dropped(demand, mass, *convention, height), [law], Criterion())[0]
            for mass in masses
            for convention in CONVENTIONS
            for height in np.geomspace(0.005, 0.02, 7).tolist()
        ]

    assert all(fallen(np.geomspace(*demand.mass, 7).tolist()))
    assert not all(fallen([0.05 / 1.06]))


@pytest.mark.thorough("test_preset_keeps_its_demand")
def test_preset_is_as_stiff_as_what_the_study_designs() -> None:
    """Another seed finds other taps of equal stiffness, up to the ragged limit."""
    demand = replace(DEMANDS["designed_d1"], lands=CONVENTIONS)
    again = stiffest(demand, np.eye(4), seed=7)
    assert again is not None
    assert parse_law("designed_d1").compile(T).h1 == pytest.approx(
        again.h1_n_per_m, rel=0.02
    )


@pytest.mark.parametrize(
    ("name", "apply"), [("designed_d0", "on_arrival"), ("designed_d1", "next_tick")]
)
def test_drop_comes_to_rest_where_the_forces_balance(name: str, apply: str) -> None:
    launch = launch_file.read("floor_drop", {"law": name, "apply": apply})
    trace = play(launch).along()
    # m g / H(1); the slowest pole is below 0.99, so 1500 ticks leave less than 10^-6 of the drop.
    assert trace.position[-1] == pytest.approx(
        -0.1 * 9.81 / parse_law(name).compile(T).h1, rel=1e-4
    )
    assert trace.force[-1] == pytest.approx(0.981, rel=1e-4)
