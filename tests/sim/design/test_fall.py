"""Compiled drops: the simulator's verdicts for rigid devices, small-step integration else."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from nodes.laws import CompiledLaw
from nodes.stability.flexible import FlexiblePlant
from sim.design.demand import CONVENTIONS, Demand, filtered
from sim.design.evolution import _lands
from sim.design.fall import Falls, fallen, falls, settled
from sim.design.landing import HEIGHTS, dropped
from sim.experiments.settling import Criterion, settles
from sim.play.one_axis import run

T = 0.002
RIGID = Demand((0.08, 0.125), 1.0, (1.0, 1.3), T, 0.99, 1e4, lands=CONVENTIONS)
MASSES = (0.08, 0.125)


def laws() -> list[CompiledLaw]:
    """Return PD from far inside to far outside of landing, plain and filtered."""
    source = np.random.default_rng(3)
    found = []
    for _ in range(12):
        stiffness, gain = source.uniform(200.0, 2500.0), source.uniform(0.3, 4.0) / T
        found += [
            CompiledLaw((stiffness + gain, -gain)),
            filtered(np.array([stiffness + gain, -gain]), 0.3),
        ]
    return found


@pytest.mark.thorough("test_a_fall_that_is_watched_is_the_simulator_s")
def test_a_rigid_device_falls_as_in_the_simulator() -> None:
    drops = falls(RIGID, MASSES, CONVENTIONS, HEIGHTS)
    scenes = [
        dropped(RIGID, mass, *convention, height)
        for mass in MASSES
        for convention in CONVENTIONS
        for height in HEIGHTS
    ]
    seen = set()
    for law in laws():
        ours, theirs = (
            settled(law, drops),
            [settles(scene, [law], Criterion())[0] for scene in scenes],
        )
        assert ours == theirs
        seen |= set(ours)
    assert seen == {True, False}


@pytest.mark.parametrize("law", laws()[::6])
def test_a_fall_that_is_watched_is_the_simulator_s(law: CompiledLaw) -> None:
    """Rigid: its positions and forces; with joint and lag: its verdict."""
    scene = dropped(RIGID, 0.1, False, True, HEIGHTS[0])
    trace = run(scene, law, 300)
    position, force = fallen(
        FlexiblePlant(0.1, RIGID.damping, RIGID.delay[1]), T, law, HEIGHTS[0], 300
    )
    # Two exact maps of one tick, 300 times rounded; a bounce multiplies that.
    assert position == pytest.approx(trace.measured, abs=1e-9)
    assert force == pytest.approx(trace.force, abs=1e-5)
    beyond = (0.004, 0.4, 30.0, 0.02)
    whole, rules = replace(RIGID, beyond=(beyond,)), Criterion()
    verdict = settled(law, falls(whole, [0.1], [(False, True)], HEIGHTS[:1]), rules)[0]
    position, _ = fallen(
        FlexiblePlant(0.1, 1.0, 1.3, 0.0, *beyond), T, law, HEIGHTS[0], rules.ticks
    )
    last = position[-(rules.ticks // 4) :]
    rests = (
        abs(last.mean() + 0.1 * 9.81 / law.h1) <= rules.tolerance
        and np.ptp(last) <= rules.tolerance
    )
    assert rests == verdict


def test_the_quick_verdict_is_that_of_the_whole_drop() -> None:
    drops = falls(RIGID, MASSES, CONVENTIONS, HEIGHTS)
    for law in laws()[::2]:
        share, failed = _lands(drops, np.array(law.taps), 0.0, 2500, 1e-4, 0)
        whole = settled(law, drops)
        assert (share == 1.0) is all(whole)
        assert share == 1.0 or not whole[failed]


def integrated(
    plant: FlexiblePlant,
    law: CompiledLaw,
    raw: bool,
    clamp: bool,
    height: float,
    ticks: int,
) -> bool:
    """Integrate a drop by Runge–Kutta, eight steps a tick, with the rules written again."""
    matrix, push = plant.continuous()
    size, parts = len(push), 8
    pull = np.zeros(size)
    pull[1] = -9.81
    if not plant.rigid:
        pull[3] = -9.81
    state, history, forces = (
        np.zeros(size),
        [0.0] * len(law.taps),
        [0.0] * (int(plant.delay) + 1),
    )
    state[0] = height
    if not plant.rigid:
        state[2] = height
    positions = []
    for _ in range(ticks):
        x = state[0]
        positions.append(x)
        history = [-x if raw or x < 0.0 else 0.0, *history[:-1]]
        force = sum(tap * old for tap, old in zip(law.taps, history, strict=True))
        if (raw and x >= 0.0) or (clamp and force < 0.0):
            force = 0.0
        forces = [force, *forces[:-1]]
        h, load = T / parts, pull + push * forces[-1]
        for _ in range(parts):
            k1 = matrix @ state + load
            k2 = matrix @ (state + 0.5 * h * k1) + load
            k3 = matrix @ (state + 0.5 * h * k2) + load
            k4 = matrix @ (state + h * k3) + load
            state = state + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        if not abs(state[0]) < 1.0:
            return False
    last = np.array(positions[-(ticks // 4) :])
    first = next(k for k, x in enumerate(positions) if x < 0.0)
    rest = -plant.mass * 9.81 / law.h1
    return bool(
        np.ptp(last) <= 1e-4
        and abs(last.mean() - rest) <= 1e-4
        and last.max() <= 0.0
        and max(positions[first:]) <= height + 1e-4
    )


@pytest.mark.parametrize(
    "beyond",
    [(0.0, 0.3, 40.0, 0.03), (1e-3, 0.0, math.inf, 0.0), (1e-3, 0.3, 40.0, 0.03)],
)
def test_a_device_with_a_joint_and_a_lag_falls_as_in_small_steps(
    beyond: tuple[float, float, float, float],
) -> None:
    """From landing to failing laws, by another method than the tick matrix."""
    asked = Demand((0.1, 0.1), 1.0, (1.0, 1.0), T, 0.99, 1e4, beyond=(beyond,))
    plant, criterion = FlexiblePlant(0.1, 1.0, 1.0, 0.0, *beyond), Criterion(ticks=600)
    drops: Falls = falls(asked, [0.1], [(False, True)], [0.005])
    told = []
    for factor in (0.3, 1.0, 4.0):
        law = CompiledLaw((factor * 2100.0, factor * -1500.0))
        told += settled(law, drops, criterion)
        assert told[-1] is integrated(plant, law, False, True, 0.005, criterion.ticks)
    assert set(told) == {True, False}
