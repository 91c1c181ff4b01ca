"""Stability for every delay sequence (THEORY.md §10): constant poles, replayed sequences."""

from __future__ import annotations

import random
from dataclasses import replace

import numpy as np
import pytest

from nodes.laws import CompiledLaw
from nodes.laws.parse import parse_law
from nodes.stability.closed_loop import pole_radius
from nodes.stability.flexible import FlexiblePlant, flexible_radius
from nodes.stability.k_max import k_max, with_spring, without_spring
from nodes.stability.plant import Plant
from sim.design.recorded_loop import replayed_radius
from sim.stability.every_delay import Certificate, _Ticks, every_delay

T, M, B = 0.002, 0.1, 1.0

LAWS: dict[str, dict[str, object]] = {
    "pd": {"kind": "pd", "stiffness": 1.0, "damping": 3.0},
    "paper_optimum": {"kind": "paper_optimum", "damping": 3.0},
    "sections": {"kind": "pd_alpha", "stiffness": 1.0, "damping": 3.0, "order": 0.8, "taps": 6,
    "gains": "paper",
                 "derivative": "oustaloup_matched"},
}  # fmt: skip
RANGES = [(0.05, 0.3), (0.0, 1.0), (0.6, 1.4), (1.0, 1.5)]


def law(name: str, share: float, delays: tuple[float, float]) -> CompiledLaw:
    """Return the law at a share of the lower K_max of the two constant delays."""
    derivative = without_spring(parse_law(LAWS[name]), T)
    limits = [k_max(derivative, Plant(T, M, B, d)).k_max_n_per_m for d in delays]
    return with_spring(derivative, share * min(k for k in limits if k is not None))


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("delay", [0.0, 0.3, 1.0, 1.7, 2.0])
def test_a_constant_sequence_has_the_poles_of_its_delay(
    name: str, delay: float
) -> None:
    some = law(name, 0.5, (0.5, 1.0))
    for around in ((delay, delay), (max(delay - 0.4, 0.0), delay + 0.4)):
        matrix = _Ticks(some, FlexiblePlant(M, B), T, around).matrix(delay, delay)
        assert np.abs(np.linalg.eigvals(matrix)).max() == pytest.approx(
            pole_radius(some, Plant(T, M, B, delay)), rel=1e-9
        )


@pytest.mark.parametrize("delays", RANGES)
def test_hull_holds_the_matrices_of_all_delays(delays: tuple[float, float]) -> None:
    from scipy.optimize import linprog

    ticks = _Ticks(
        law("paper_optimum", 0.5, delays), FlexiblePlant(M, B, 0.0, 200.0), T, delays
    )
    corners = ticks.hull().reshape(len(ticks.hull()), -1).T
    for older in np.linspace(*delays, 5).tolist():
        for newer in np.linspace(*delays, 5).tolist():
            inside = ticks.matrix(older, newer).ravel()
            scale = np.abs(inside).max()
            size = corners.shape[1]
            found = linprog(
                np.zeros(size),
                A_eq=np.vstack([corners[:] / scale, np.ones(size)]),
                b_eq=np.append(inside / scale, 1.0),
                bounds=[(0.0, 1.0)] * size,
            )
            assert found.success


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("delays", RANGES)
def test_just_inside_is_certified_and_just_outside_grows(
    name: str, delays: tuple[float, float]
) -> None:
    inside = every_delay(law(name, 0.97, delays), Plant(T, M, B), delays)
    assert inside.stable is Certificate.CERTIFIED
    assert inside.rate is not None
    assert inside.growth <= inside.rate < 1.0
    outside = every_delay(law(name, 1.01, delays), Plant(T, M, B), delays)
    assert outside.stable is Certificate.UNSTABLE
    assert outside.growth > 1.0
    assert all(delays[0] <= d <= delays[1] for d in outside.growing)


@pytest.mark.parametrize("delays", [(0.05, 0.3), (0.6, 1.4)])
def test_replays_agree_with_the_certificate_and_with_the_counterexample(
    delays: tuple[float, float],
) -> None:
    """By the simulator's own device, split at each arrival."""
    source = random.Random(3)  # noqa: S311  # reproducible, not secret
    inside = law("paper_optimum", 0.97, delays)
    for _ in range(3):
        sequence = [
            source.choice((delays[0], delays[1], source.uniform(*delays)))
            for _ in range(1500)
        ]
        assert replayed_radius(inside, Plant(T, M, B), sequence) < 1.0
    outside = law("paper_optimum", 1.02, delays)
    found = every_delay(outside, Plant(T, M, B), delays)
    repeated = list(found.growing) * (1500 // len(found.growing))
    # The mean factor between first and last quarter is the growth but for the phase of the swing at
    # either end.
    assert replayed_radius(outside, Plant(T, M, B), repeated) == pytest.approx(
        found.growth, abs=2e-4
    )
    assert found.growth > 1.0


def test_a_rate_can_be_demanded() -> None:
    some = law("pd", 0.5, (0.0, 0.5))
    radius = max(pole_radius(some, Plant(T, M, B, d)) for d in (0.0, 0.5))
    assert (
        every_delay(some, Plant(T, M, B), (0.0, 0.5), rate=0.5 * (1.0 + radius)).stable
        is Certificate.CERTIFIED
    )
    assert (
        every_delay(some, Plant(T, M, B), (0.0, 0.5), rate=radius - 1e-3).stable
        is Certificate.UNSTABLE
    )


def test_what_cannot_be_certified_is_refused() -> None:
    with pytest.raises(
        ValueError,
        match=r"^delay 0\.5\.\.1\.6 ticks: expected low to high, at most one tick apart",
    ):
        every_delay(law("pd", 0.5, (0.5, 1.0)), Plant(T, M, B), (0.5, 1.6))
    with pytest.raises(
        ValueError, match=r"^law: 1002 states, at most 40 are certified"
    ):
        every_delay(CompiledLaw((1000.0,) * 1000), Plant(T, M, B), (0.0, 0.5))


JOINT = FlexiblePlant(M, B, share=0.3, frequency=40.0, loss=0.03)
LAG = FlexiblePlant(M, B, lag=1e-3)
BOTH = FlexiblePlant(M, B, 0.0, 150.0, 1e-3, 0.3, 40.0, 0.03)


@pytest.mark.parametrize("plant", [JOINT, LAG, BOTH], ids=["joint", "lag", "both"])
@pytest.mark.parametrize("delays", [(0.05, 0.5), (0.8, 1.3)])
def test_a_joint_and_a_lag_are_certified_too(
    plant: FlexiblePlant, delays: tuple[float, float]
) -> None:
    """Just inside the worse constant delay's limit; refuted outside by poles."""

    def radius(some: CompiledLaw, delay: float) -> float:
        return flexible_radius(some, T, replace(plant, delay=delay))

    shape = CompiledLaw((1600.0, -900.0))

    def scaled(factor: float) -> CompiledLaw:
        return CompiledLaw(tuple(factor * tap for tap in shape.taps))

    low, high = 0.0, 16.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        stable = max(radius(scaled(middle), delay) for delay in delays) < 1.0
        low, high = (middle, high) if stable else (low, middle)
    # Half of the edge: with a joint, a delay that switches in its rhythm is worse than each
    # constant one.
    inside = scaled(0.5 * low)
    ticks = _Ticks(inside, plant, T, delays)
    for delay in delays:
        poles = np.abs(np.linalg.eigvals(ticks.matrix(delay, delay))).max()
        # Eigenvalues of a matrix with two close to 1: the square root of the machine epsilon.
        assert poles == pytest.approx(radius(inside, delay), abs=1e-7)
    found = every_delay(inside, plant, delays, period=T)
    assert found.stable is Certificate.CERTIFIED
    assert found.rate is not None
    assert found.growth <= found.rate < 1.0
    assert (
        every_delay(scaled(1.01 * low), plant, delays, period=T).stable
        is Certificate.UNSTABLE
    )
    # Nothing is left out between the corners: every matrix is as near to the hull as is said, in
    # the identity's norm.
    hull = ticks.hull()
    off = ticks.off(np.eye(ticks.size))
    for older in np.linspace(*delays, 7).tolist():
        for newer in np.linspace(*delays, 7).tolist():
            assert _distance(ticks.matrix(older, newer), hull) <= off + 1e-7


def _distance(matrix: np.ndarray, hull: np.ndarray) -> float:
    """Return the largest remaining entry of a matrix beside the nearest point of a hull."""
    from scipy.optimize import linprog

    count, flat = len(hull), hull.reshape(len(hull), -1).T
    rows = np.vstack(
        [
            np.hstack([flat, -np.ones((len(flat), 1))]),
            np.hstack([-flat, -np.ones((len(flat), 1))]),
        ]
    )
    limits = np.concatenate([matrix.ravel(), -matrix.ravel()])
    found = linprog(
        np.append(np.zeros(count), 1.0),
        A_ub=rows,
        b_ub=limits,
        A_eq=np.append(np.ones(count), 0.0)[None],
        b_eq=[1.0],
        bounds=[(0.0, 1.0)] * count + [(0.0, None)],
    )
    assert found.success
    assert found.fun is not None
    return float(found.fun)


def test_a_flexible_device_needs_the_period() -> None:
    with pytest.raises(
        ValueError, match=r"^period: a flexible device has none of its own"
    ):
        every_delay(CompiledLaw((100.0,)), JOINT, (0.0, 0.5))
