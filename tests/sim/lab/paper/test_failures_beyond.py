"""Limits beyond a rigid device at one rate: checked on both sides by another method."""

from __future__ import annotations

import math

import numpy as np
import pytest

from nodes.laws.pd import PD
from nodes.stability.flexible import FlexiblePlant, flexible_radius
from nodes.stability.k_max import k_max, without_spring
from nodes.stability.plant import Plant
from sim.identify.alterations import stiffest
from sim.lab.paper import failures_beyond as beyond
from tests.support import slowly

FINDERS = {find.__name__: find for find in beyond.BEYOND}


@pytest.mark.parametrize(
    "name",
    slowly(
        FINDERS, but=["two_rates", "encoder_and_friction", "bounce", "unknown_world"]
    ),
)
def test_two_methods_put_each_boundary_in_the_same_place(name: str) -> None:
    edge = FINDERS[name]()
    assert edge.agreed, edge
    # An edge that is a few margins off is seen: the second method does decide.
    assert 0.0 < abs(edge.margin) <= 0.1


def test_the_edge_before_any_world_is_the_one_of_the_table() -> None:
    """Reference digits: PD, B 3 N s/m, 0.1 kg, 1 N s/m, no delay."""
    assert beyond.unknown_world().value == pytest.approx(2244.217, abs=2e-3)


def test_a_servo_s_edge_is_below_that_of_a_heavy_device() -> None:
    # THEORY.md §13, for N = 4
    assert beyond.two_rates().value == pytest.approx(1361.0, rel=1e-3)


@pytest.mark.parametrize("delay", [0.0, 0.3, 1.0, 2.5])
def test_the_stiffest_pd_on_a_flexible_device_is_k_max_of_a_rigid_one(
    delay: float,
) -> None:
    """One curve for both; with joint and lag, where a pole leaves the circle."""
    rigid = k_max(
        without_spring(PD(stiffness=1.0, damping=1.5), 0.002),
        Plant(0.002, 0.1, 1.0, delay),
    ).k_max_n_per_m
    # Linear between 4000 points of the circle.
    assert stiffest(FlexiblePlant(0.1, 1.0, delay), 0.002, 1.5) == pytest.approx(
        rigid, rel=1e-5
    )
    plant = FlexiblePlant(0.1, 1.0, delay, 0.0, 1e-3, 0.3, 60.0, 0.03)
    edge = stiffest(plant, 0.002, 1.5)
    assert edge is not None
    inside, outside = (
        flexible_radius(
            PD(stiffness=edge * s, damping=1.5).compile(0.002), 0.002, plant
        )
        for s in (0.9999, 1.0001)
    )
    assert inside < 1.0 < outside


def test_a_swing_that_shrinks_is_told_from_one_that_grows() -> None:
    ticks = np.arange(4000)
    for rate in (0.9999, 1.0001):
        assert beyond._shrinks(rate**ticks * np.cos(0.3 * ticks)) is (rate < 1.0)
    assert math.isfinite(beyond.TURNS)
