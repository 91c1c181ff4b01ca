"""No drop refutes a proof of landing: random laws and devices, dropped long enough."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from nodes.laws import CompiledLaw
from nodes.laws.parse import parse_law
from nodes.laws.presets import preset_names
from nodes.stability.closed_loop import pole_radius
from nodes.stability.landing_proof import prove_landing
from nodes.stability.plant import Plant
from sim.design.demand import Demand
from sim.design.fall import falls, settled
from sim.design.landing import prove_over
from sim.experiments.settling import Criterion

T = 0.002
HEIGHTS = (0.001, 0.003, 0.01, 0.03)


def drawn(seed: int) -> tuple[CompiledLaw, Plant]:
    """Return random PD with up to four more taps and a device, up to just above the limit."""
    rng = np.random.default_rng(seed)
    plant = Plant(
        T,
        10 ** rng.uniform(-1.5, 0.0),
        10 ** rng.uniform(-1.0, 0.7),
        float(rng.choice([0.0, 0.5, 1.0, 2.0])),
    )
    unit = plant.mass / T**2
    taps = (
        rng.normal(0.0, 0.1, rng.integers(2, 7)) * unit * 10 ** rng.uniform(-2.0, 0.0)
    )
    stiffness = 10 ** rng.uniform(-3.5, -0.3) * unit
    taps -= taps.mean() - stiffness / len(taps)
    taps[:2] += np.array([1.0, -1.0]) * 10 ** rng.uniform(-2.5, -0.2) * unit
    return CompiledLaw(tuple(taps.tolist())), plant


def drawn_of_a_kind(seed: int) -> tuple[CompiledLaw, Plant]:
    """Return a random law of a shipped kind, or a scaled preset, and a random device."""
    rng = np.random.default_rng(seed)
    plant = Plant(
        T,
        10 ** rng.uniform(-1.5, 0.0),
        10 ** rng.uniform(-1.0, 0.7),
        float(rng.choice([0.0, 1.0, 2.0, rng.uniform(0.0, 2.0)])),
    )
    unit = plant.mass / T**2
    spring = float(10 ** rng.uniform(-3.5, -0.5) * unit)
    damping = float(10 ** rng.uniform(-2.5, -0.2) * plant.mass / T)
    order, taps = float(rng.uniform(0.1, 1.9)), int(rng.integers(2, 9))
    term, late = {"gain": 1.0, "order": order}, {"gain": 0.5, "order": order + 1.0}
    kinds: list[dict[str, object]] = [
        {"kind": "pd"},
        {"kind": "pd_alpha", "order": order, "taps": taps, "gains": "paper"},
        {"kind": "pd_filtered", "cutoff": float(10 ** rng.uniform(1.0, 2.3))},
        {"kind": "multi_term", "terms": [term, late], "taps": taps, "gains": "paper"},
        {
            "kind": "fractional_sls",
            "order": order / 2.0 + 0.05,
            "relaxation": float(10 ** rng.uniform(-3.0, 0.0)),
        },
    ]
    pick = int(rng.integers(len(kinds) + 1))
    if pick < len(kinds):
        text = {**kinds[pick], "stiffness": spring, "damping": damping}
        return parse_law(text).compile(T), plant
    law, scale = (
        parse_law(str(rng.choice(preset_names()))).compile(T),
        10 ** rng.uniform(-0.7, 0.5),
    )
    return (
        CompiledLaw(
            tuple(scale * tap for tap in law.taps),
            tuple((scale * b0, scale * b1, a1, a2) for b0, b1, a1, a2 in law.sections),
        ),
        plant,
    )


def refuted(
    seeds: range, draw: Callable[[int], tuple[CompiledLaw, Plant]] = drawn
) -> tuple[int, int, list[int]]:
    """Return how many laws are stable, how many proven, and which proven ones fail to settle."""
    stable, proven, wrong = 0, 0, []
    for seed in seeds:
        law, plant = draw(seed)
        radius = pole_radius(law, plant)
        # A slower one is stable, and takes longer than is played here.
        if not (law.h1 > 0.0 and radius < 0.999):
            continue
        stable += 1
        if prove_landing(law, plant).proven:
            proven += 1
            demand = Demand(
                (plant.mass, plant.mass),
                plant.damping,
                (plant.delay, plant.delay),
                T,
                1.0,
                math.inf,
            )
            # From 0.1 m of sink at most down to 1e-4 m, four times over, and the flights before it.
            ticks = 4000 + math.ceil(30.0 / -math.log(radius))
            drops = falls(demand, [plant.mass], [(False, False)], HEIGHTS)
            tall = [
                one for one in settled(law, drops, Criterion(ticks=ticks)) if not one
            ]
            if tall:
                wrong.append(seed)
    return stable, proven, wrong


def test_no_proof_of_a_few_random_laws_is_refuted_by_a_drop() -> None:
    stable, proven, wrong = refuted(range(40))
    assert wrong == []
    assert proven > stable // 2 > 3


@pytest.mark.slow
def test_no_proof_of_many_random_laws_is_refuted_by_a_drop() -> None:
    stable, proven, wrong = refuted(range(2500))
    assert wrong == []
    assert stable > 1000
    assert proven > 0.8 * stable


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_no_proof_of_a_law_of_any_kind_is_refuted_by_a_drop() -> None:
    """Sections, fractional terms and scaled presets, at any fraction of a tick."""
    stable, proven, wrong = refuted(range(10_000, 12_500), drawn_of_a_kind)
    assert wrong == []
    assert stable > 1000
    assert proven > 0.9 * stable


@pytest.mark.parametrize("name", preset_names())
def test_no_proof_of_a_preset_is_refuted_by_a_drop(name: str) -> None:
    law = parse_law(name).compile(T)
    for delay in (0.0, 1.0):
        demand = Demand((0.05, 0.2), 1.0, (delay, delay), T, 1.0, math.inf)
        if prove_over(law, demand).proven:
            for mass in (0.05, 0.2):
                # Laws for any hand ring for minutes on a wall that nobody holds the device at.
                radius = pole_radius(law, Plant(T, mass, 1.0, delay))
                ticks = 4000 + math.ceil(30.0 / -math.log(radius))
                assert all(
                    settled(
                        law,
                        falls(demand, [mass], [(False, False)], HEIGHTS[::3]),
                        Criterion(ticks=ticks),
                    )
                )


def test_a_range_is_proven_only_where_every_corner_is() -> None:
    law = parse_law({"kind": "pd", "stiffness": 1200.0, "damping": 3.0}).compile(T)
    proof = prove_over(law, Demand((0.1, 0.1), 1.0, (1.0, 1.0), T, 1.0, math.inf))
    assert proof.proven
    assert proof.cases == 1
    later = prove_over(law, Demand((0.1, 0.1), 1.0, (1.0, 1.1), T, 1.0, math.inf))
    assert not later.proven
    assert "1.1 ticks" in later.text()
