"""Step tests and the climb: verdicts at the limit, and the limit by poles."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from nodes.laws.parse import parse_law
from nodes.laws.pd import PD
from nodes.stability.k_max import k_max, without_spring
from nodes.stability.plant import Plant
from sim.device.model import DeviceModel
from sim.drill.given_design import given_design, given_prediction
from sim.tune.design import linear_edge
from sim.tune.knocking import (
    BEYOND,
    DEEPEST,
    DYING,
    FAR,
    LEFT,
    LONGEST_WINDOW,
    LOWEST,
    NEAR,
    STEP,
    WINDOW,
    KnockedEdge,
    KnockVerdict,
    Plan,
    climb,
    factor_of,
    judge,
    knocked,
    planned,
)
from sim.tune.outcome import MARGIN, compared, headline, verified
from sim.tune.record import PredictedStep, TuneRecord
from sim.tune.tuning_text import number

T = 0.002
KNOCK = 1e-3


def swing(radius: float, ticks: int = LONGEST_WINDOW) -> np.ndarray:
    """Swing from a knock away about the place that is asked for, by a pole of this radius."""
    k = np.arange(ticks)
    return np.asarray(KNOCK - KNOCK * radius**k * np.cos(0.5 * np.pi * k))


def test_the_verdict_at_its_edge() -> None:
    # The last third begins after 2/3 of the window: there the swing is as wide as its radius to
    # that power, times two knocks.
    begins = WINDOW - WINDOW // 3
    just = (0.5 * LEFT) ** (1.0 / begins)
    for radius, rests in ((just * 0.9995, True), (just * 1.0005, None)):
        verdict = judge(swing(radius, WINDOW), KNOCK, 1.0)
        assert (verdict and verdict.rests) is rests


@pytest.mark.parametrize(
    ("radius", "rests"),
    [(0.9996, True), (0.9999, False), (1.0, False), (1.0003, False)],
)
def test_what_is_left_must_go_on_dying(radius: float, rests: bool) -> None:
    # A third of the longest window is 533 ticks: a radius of 0.9998 leaves 0.9 of it.
    assert pytest.approx(0.9998, abs=1e-5) == DYING ** (1.0 / (LONGEST_WINDOW // 3))
    verdict = judge(swing(radius), KNOCK, 1.0)
    assert verdict is not None
    assert verdict.rests is rests


def test_far_and_not_finite_do_not_rest() -> None:
    away = np.zeros(WINDOW)
    away[5] = -(FAR - 1.0) * KNOCK * 1.001
    for position in (away, np.full(WINDOW, np.nan)):
        verdict = judge(position, KNOCK, 1.0)
        assert verdict is not None
        assert not verdict.rests
        assert "knocks away" in verdict.why
    away[5] = -(FAR - 1.0) * KNOCK * 0.999
    assert (verdict := judge(away, KNOCK, 1.0)) is not None
    assert verdict.rests
    assert judge(away[:10], KNOCK, 1.0) is None


def device(edge: int, tried: list[int]) -> Callable[[int], KnockVerdict]:
    """Return a device that rests below a step, and records what was asked."""

    def knock(step: int) -> KnockVerdict:
        tried.append(step)
        return KnockVerdict(factor_of(step), 0.1 if step < edge else 2.0, step < edge)

    return knock


@pytest.mark.parametrize("edge", [13, 8, 1, 0, -1, -3, -37, LOWEST, LOWEST - 25])
def test_the_climb_begins_below_and_finds_the_step(edge: int) -> None:
    tried: list[int] = []
    found = climb(Plan(LOWEST, 12 - NEAR, 12 + BEYOND), device(edge, tried))
    assert found.factor == factor_of(edge)
    assert found.rested == factor_of(edge - 1)
    assert tried[0] == LOWEST
    # Never further beyond what rests than a large step; and the law itself was tried where the way
    # leads past it.
    assert (
        max(
            b - max([a for a in tried[:i] if a < edge], default=b)
            for i, b in enumerate(tried)
        )
        <= 10
    )
    assert edge <= 0 or 0 in tried


def test_a_device_that_never_rests_is_left_alone() -> None:
    tried: list[int] = []
    found = climb(Plan(LOWEST, 8, 24), device(DEEPEST - 100, tried))
    assert found.rested is None
    assert min(tried) >= DEEPEST
    assert "nothing came to rest" in found.ended


def predicted(edge: float, linear: float) -> PredictedStep:
    return given_prediction(1000.0, linear, edge_factor=edge)


LAW = given_design([1000.0], 0.002, lands=True)


def climbed(edge: int) -> KnockedEdge:
    return climb(Plan(LOWEST, 8, 24), device(edge, []))


@pytest.mark.parametrize("edge", [1, 0, -20])
def test_a_law_that_does_not_rest_does_not_hold(edge: int) -> None:
    told = verified(predicted(1.27, 1.25), climbed(edge))
    assert not told.holds
    assert "NOT hold" in headline(TuneRecord(designed=LAW, verified=told))


def test_a_law_that_only_friction_holds_does_not_hold() -> None:
    # Knocks on the model see the edge at 1.32 where its poles have it at 1.1: friction. So 1.2 by
    # knocks is 1.0 by poles.
    assert verified(
        predicted(1.27, 1.25), climbed(round(math.log(1.2) / math.log(STEP)))
    ).holds
    told = verified(
        predicted(1.32, 1.1), climbed(round(math.log(1.2) / math.log(STEP)))
    )
    assert told.edge_by_poles_between_n_per_m is not None
    low, high = told.edge_by_poles_between_n_per_m
    # A step on either side of what knocks and model say, 1000 and 1100 N/m; too far apart for one
    # figure.
    assert low == pytest.approx(1000.0 / STEP, rel=STEP - 1.0)
    assert high == pytest.approx(1100.0 * STEP)
    assert told.edge_by_poles_h1_n_per_m is None
    assert low < 1000.0 * MARGIN
    assert not told.holds
    assert (
        f"a large motion may be unstable from {low / 1000.0:.3f} times on" in told.ended
    )


@pytest.mark.parametrize(
    ("steps", "told_as_one"),
    [(0, True), (2, True), (3, False), (-2, True), (-3, False)],
)
def test_an_edge_that_is_not_known_to_5_percent_is_told_as_an_interval(
    steps: int, told_as_one: bool
) -> None:
    # The poles of the true device may be where the model has them, or where the measured knocks put
    # them.
    expected = round(math.log(1.3) / math.log(STEP))
    told = verified(predicted(factor_of(expected), 1.25), climbed(expected + steps))
    assert told.edge_by_poles_between_n_per_m is not None
    low, high = told.edge_by_poles_between_n_per_m
    truths = (1250.0, 1250.0 * STEP**steps)
    assert all(low < truth < high for truth in truths)
    point = told.edge_by_poles_h1_n_per_m
    assert (point is not None) is told_as_one
    assert point is None or abs(point / min(truths) - 1.0) < 0.05
    words = headline(TuneRecord(designed=LAW, verified=told))
    # Never above the truth: the lower end of what was measured, which also came to rest.
    rested = told.stiffest_at_rest_n_per_m
    assert rested is not None
    assert point is None or point <= min(*truths, rested)
    assert ("or above" in words) is told_as_one
    assert f"between {number(low)} and {number(high)} N/m" in words


@pytest.mark.parametrize(
    ("measured", "agrees"), [(1.41, False), (1.38, True), (1.16, True), (1.12, False)]
)
def test_a_device_whose_edge_is_elsewhere_is_not_the_one_that_was_identified(
    measured: float, agrees: bool
) -> None:
    # A joint that dry friction holds while knocks are small: its edge by poles may be anywhere
    # below.
    told = verified(
        predicted(1.27, 1.25), climbed(round(math.log(measured) / math.log(STEP)))
    )
    assert told.holds is told.agrees is agrees
    assert (told.edge_by_poles_between_n_per_m is not None) is agrees
    assert ("differs from the identified one" in told.ended) is not agrees


def test_an_edge_that_was_not_found_is_not_compared_and_nothing_is_delivered() -> None:
    told = verified(predicted(1.27, 1.25), climbed(100))
    assert not told.holds
    assert told.edge_factor is None
    assert told.edge_error is None


def test_two_grids_of_two_per_cent_are_told_as_what_they_are() -> None:
    assert compared(1.27, 1.27)[1] == "the same step of 2 %"
    assert compared(1.27, 1.27 * STEP)[1] == "+2 % from the predicted one"
    assert compared(None, 1.27)[0] is None


@pytest.mark.slow
@pytest.mark.parametrize(
    ("preset", "delay"), [("designed_d0", 0.0), ("designed_d1", 1.0)]
)
def test_knocking_finds_the_edge_that_the_poles_have(preset: str, delay: float) -> None:
    """Without friction and encoder the loop is linear: pole radii give the limit."""
    law = parse_law({"kind": preset}).compile(T)
    linear = linear_edge(law, Plant(T, 0.1, 1.0, delay))
    bare = DeviceModel(mass=0.1, damping=1.0, delay=delay)
    plan, edge = planned(knocked(law, bare, T, KNOCK, None, None), linear)
    assert edge.factor is not None
    # What hardly dies is not told from what does not: a step or two below the edge, and at most one
    # above it.
    assert linear / STEP**3 <= edge.factor <= linear * STEP
    assert climb(plan, knocked(law, bare, T, KNOCK, None, None)).factor == edge.factor


def test_the_linear_edge_is_where_a_pole_reaches_the_circle() -> None:
    law, plant = PD(stiffness=300.0, damping=2.0).compile(T), Plant(T, 0.1, 1.0, 1.3)
    edge = linear_edge(law, plant)
    grown = PD(stiffness=300.0 * edge, damping=2.0 * edge)
    assert k_max(without_spring(grown, T), plant).k_max_n_per_m == pytest.approx(
        300.0 * edge, rel=1e-6
    )
