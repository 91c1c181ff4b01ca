"""Every limit from both sides, and every trap of the theory, on the study's numbers."""

from __future__ import annotations

import math

import numpy as np
import pytest

from nodes.laws import CompiledLaw
from nodes.laws.derivatives.gl import coefficients
from nodes.stability.closed_loop import pole_radius
from nodes.stability.k_max import k_max, with_spring
from nodes.stability.plant import Plant
from sim.device.model import DeviceModel
from sim.experiments.drop import drop_scene
from sim.experiments.settling import Criterion, settles
from sim.lab.charts.integrators import euler, spring_limit
from sim.lab.paper import failures
from sim.lab.paper.claims import FAILS


@pytest.mark.slow
def test_both_methods_put_every_boundary_in_the_same_place() -> None:
    found = [
        edge
        for edge in map(failures.both_sides, failures.boundaries())
        if edge is not None
    ]
    assert len(found) == 11
    for edge in found:
        assert edge.agreed, edge.name


@pytest.mark.parametrize("substeps", [2, 4, 10])
def test_euler_overstates_k_max(substeps: int) -> None:
    found, predicted = failures.euler_bias(substeps)
    # 1/(1 − 1/n) is the limit of a heavy device; at 10 kg the next order is bT/m = 2e-4 of it.
    assert found == pytest.approx(predicted, rel=1e-3)


def test_one_euler_step_per_tick_hides_the_limit_of_a_spring() -> None:
    # n_sub = 1: the prediction is infinite; what limits it then is κ < 4 − O(β), sixteen times the
    # damper's 2b/T here.
    exact = k_max(CompiledLaw((0.0,)), Plant(failures.PERIOD, 0.1, 1.0)).k_max_n_per_m
    assert exact is not None
    assert spring_limit(euler(1, True, 0.1, 1.0)) > 16.0 * exact


@pytest.mark.parametrize("order", [0.5, 1.5, 3.47])
def test_gamma_ratio_is_right_until_it_overflows(order: float) -> None:
    # Γ(m+1) overflows from m = 171 on; before, the ratio is good to a few hundred roundings of its
    # factors.
    assert failures.gamma_coefficient(order, 170) == pytest.approx(
        coefficients(order, 171)[170], rel=1e-12
    )
    assert failures.gamma_coefficient(order, 171) == 0.0
    assert coefficients(order, 172)[171] != 0.0


def test_leak_eats_the_stiffness() -> None:
    limit = failures.leak_boundary()
    inside, outside = failures.leak_law(0.99 * limit), failures.leak_law(1.01 * limit)
    # K + B·D(1) is linear in B: 1 % to either side of its zero it is 1 % of K.
    assert inside.h1 == pytest.approx(10.0, rel=1e-9)
    assert outside.h1 == pytest.approx(-10.0, rel=1e-9)
    assert (
        pole_radius(inside, Plant(failures.PERIOD, 5.0, 1.0))
        < 1.0
        < pole_radius(outside, Plant(failures.PERIOD, 5.0, 1.0))
    )
    # And the heavy device sinks through that floor.
    scene = drop_scene(
        DeviceModel(mass=5.0, damping=1.0), failures.PERIOD, False, True, height=1e-4
    )
    assert settles(scene, [outside], Criterion(20_000)) == [False]


@pytest.mark.slow
def test_tustin_expanded_for_the_whole_order_runs_away_in_the_loop() -> None:
    whole, split = (
        failures.tustin_whole(500.0, 0.05),
        failures.tustin_split(500.0, 0.05),
    )
    assert not whole.stable_sections()
    assert split.stable_sections()
    scene = drop_scene(DeviceModel(mass=0.1, damping=1.0), failures.PERIOD, False, True)
    assert settles(scene, [whole, split], Criterion()) == [False, True]
    assert pole_radius(whole, Plant(failures.PERIOD, 0.1, 1.0)) > 1.1
    assert pole_radius(split, Plant(failures.PERIOD, 0.1, 1.0)) < 1.0


def test_whole_order_section_is_the_product_of_its_zeros_and_poles() -> None:
    from nodes.laws.derivatives.cfe import whole_order

    zeros, poles = whole_order(1.5, 2, 1.0)
    law = failures.tustin_whole(0.0, 1.0)
    for angle in (0.1, 1.0, 2.5):
        z = complex(math.cos(angle), math.sin(angle))
        product = (
            (2.0 / failures.PERIOD) ** 1.5
            * np.prod([z - q for q in zeros])
            / np.prod([z - p for p in poles])
        )
        # A handful of roundings through the partial fraction.
        assert law.response(z) == pytest.approx(complex(product), rel=1e-12)


def test_tight_tuning_does_not_travel() -> None:
    told = failures.fragility()
    for law in ("pd", "optimum"):
        for loop, (radius, settled) in told[law].items():
            # Away from the boundary by more than 1e-3 per tick, 20 000 ticks leave no doubt.
            if abs(radius - 1.0) > 1e-3:
                assert settled == (radius < 1.0), (law, loop)
    assert told["optimum"]["as tuned"][1]
    assert not told["optimum"]["one tick of delay"][1]
    assert not told["optimum"]["half the mass"][1]


def test_friction_above_the_bound_stops_all_chatter() -> None:
    for law in (
        with_spring(failures.optimum(3.0), 1000.0),
        CompiledLaw((2500.0, -1500.0)),
    ):
        bound = 0.5 * 2.3e-5 * law.h_nyquist
        assert not failures.chatter(law, 1.01 * bound)
    # Without friction the encoder's edge feeds the buzz.
    assert failures.chatter(CompiledLaw((2500.0, -1500.0)), 0.0)


def test_no_trap_of_the_theory_fails_to_spring() -> None:
    claims = failures.traps()
    assert len(claims) == 8
    assert [claim.claim for claim in claims if claim.verdict == FAILS] == []
