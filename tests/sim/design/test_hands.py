"""Bounded hands: batches against the two-mass plant, known limits, attacked certificates."""

from __future__ import annotations

import itertools
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nodes.cli.main import main
from nodes.laws import CompiledLaw
from nodes.laws.parse import parse_law
from nodes.stability.closed_loop import pole_radius
from nodes.stability.flexible import flexible_radius
from nodes.stability.k_max import with_spring, without_spring
from nodes.stability.plant import Plant
from sim.design.demand import Demand
from sim.design.hand_box import HandBox
from sim.design.hands import STYLUS, judge_grasps, k_max_over, worst_grasp
from sim.design.hands_certificate import certify_box
from sim.stability.every_delay import Certificate
from sim.stability.grasp import Grasp

T = 0.002


def pd(stiffness: float, damping: float = 3.0) -> CompiledLaw:
    return parse_law(
        {"kind": "pd", "stiffness": stiffness, "damping": damping}
    ).compile(T)


def alone(plant: Plant, grasp: Grasp, law: CompiledLaw) -> float:
    """Return the pole radius of a two-mass device with one grasp, by scipy's expm."""
    return flexible_radius(
        law,
        plant.period,
        grasp.holds(plant.mass, plant.damping, plant.delay, plant.stiffness),
    )


@given(
    st.floats(-3.5, 0.5),
    st.floats(1.0, 5.0),
    st.floats(0.0, 3.0),
    st.sampled_from([0.0, 0.4, 1.0, 1.5]),
)
@settings(max_examples=40, deadline=None)
def test_radius_is_that_of_two_masses_on_a_joint(
    mass: float, stiffness: float, damping: float, delay: float
) -> None:
    grasp = Grasp(10.0**mass, 10.0**stiffness, damping)
    plant = Plant(T, 0.08, 1.2, delay, 30.0)
    box = HandBox(
        (grasp.mass, grasp.mass),
        (grasp.stiffness, grasp.stiffness),
        (grasp.damping, grasp.damping),
    )
    # A double pole is known to the square root of the machine's epsilon.
    assert worst_grasp(pd(500.0), plant, box).radius == pytest.approx(
        alone(plant, grasp, pd(500.0)), rel=1e-7
    )


def test_a_hand_that_does_not_give_way_is_a_spring_to_the_ground() -> None:
    """A million kilograms behind 400 N/m equal the plant with that stiffness (§3)."""
    plant, rigid = Plant(T, 0.1, 1.0, 1.0), Plant(T, 0.1, 1.0, 1.0, 400.0)
    # Beyond the edge, where the swing is the largest pole and not the mass itself, which hardly
    # moves.
    for stiffness in (1800.0, 2200.0):
        wanted = pole_radius(pd(stiffness), rigid)
        assert wanted > 1.01
        assert alone(plant, Grasp(1e6, 400.0, 0.0), pd(stiffness)) == pytest.approx(
            wanted, rel=1e-6
        )


def test_worst_of_a_box_is_found_and_is_one_of_it() -> None:
    plant, box = (
        Plant(T, 0.1, 1.0, 1.0),
        HandBox((0.005, 0.3), (100.0, 2000.0), (0.2, 5.0)),
    )
    found = worst_grasp(pd(800.0), plant, box)
    assert alone(plant, found.grasp, pd(800.0)) == pytest.approx(found.radius, rel=1e-9)
    rng = np.random.default_rng(1)
    random = [Grasp(*(rng.uniform(*side) for side in box.sides)) for _ in range(200)]
    # The grid closes in on one worst place: within 1e-4 of what 200 draws find.
    assert max(alone(plant, one, pd(800.0)) for one in random) <= found.radius + 1e-4


@pytest.mark.parametrize("delay", [0.0, 0.5, 1.0])
def test_no_grasp_of_a_certified_box_is_unstable(delay: float) -> None:
    plant, box = (
        Plant(T, 0.1, 1.0, delay),
        HandBox((0.02, 0.022), (400.0, 450.0), (1.0, 1.1)),
    )
    law = pd(300.0, 1.0)
    proven, cells = certify_box(law, plant, box)
    assert proven is Certificate.CERTIFIED
    assert cells > 1
    rng = np.random.default_rng(2)
    for _ in range(100):
        assert (
            alone(plant, Grasp(*(rng.uniform(*side) for side in box.sides)), law) < 1.0
        )


def test_near_the_edge_the_certificate_ends_where_the_poles_do() -> None:
    """One grasp: certified at 0.99 of its limit, not at 1.01."""
    plant, grasp = Plant(T, 0.1, 1.0, 1.0), Grasp(0.05, 500.0, 1.0)
    low, high = 100.0, 5000.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (
            (middle, high)
            if alone(plant, grasp, pd(middle, 1.0)) < 1.0
            else (low, middle)
        )
    box = HandBox((0.05, 0.0501), (500.0, 501.0), (1.0, 1.002))
    assert certify_box(pd(0.99 * low, 1.0), plant, box)[0] is Certificate.CERTIFIED
    assert certify_box(pd(1.01 * low, 1.0), plant, box, 500)[0] is Certificate.UNDECIDED
    assert (
        worst_grasp(pd(1.01 * low, 1.0), plant, box, certify=True).certified
        is Certificate.UNSTABLE
    )


@pytest.mark.parametrize("delay", [0.0, 0.37, 1.5])
def test_a_stiff_grasp_of_next_to_no_mass_has_no_proof(delay: float) -> None:
    """(21.2) grows as e^|A|: too large for doubles with 3 mg behind 30 kN/m."""
    box = HandBox((3e-6, 3.1e-6), (3e4, 9e4), (7.0, 21.0))
    assert (
        certify_box(pd(500.0, 1.0), Plant(T, 0.1, 1.0, delay), box, 50)[0]
        is Certificate.UNDECIDED
    )


@pytest.mark.parametrize("side", ["mass", "stiffness", "damping"])
def test_a_box_across_the_edge_is_never_certified(side: str) -> None:
    """Centred on the limit, one end of the box is slightly unstable: 2 % of one number."""
    plant, middle = (
        Plant(T, 0.1, 1.0, 1.0),
        {"mass": 0.05, "stiffness": 500.0, "damping": 1.0},
    )
    low, high = 100.0, 5000.0
    for _ in range(40):
        stiffness = 0.5 * (low + high)
        low, high = (
            (stiffness, high)
            if alone(plant, Grasp(**middle), pd(stiffness, 1.0)) < 1.0
            else (low, stiffness)
        )
    box = HandBox(
        **{
            name: (0.98 * value, 1.02 * value) if name == side else (value, value)
            for name, value in middle.items()
        }
    )
    ends = [alone(plant, grasp, pd(low, 1.0)) for grasp in box.corners()]
    assert min(ends) < 1.0 < max(ends) < 1.01
    assert certify_box(pd(low, 1.0), plant, box, 3000)[0] is Certificate.UNDECIDED


def test_k_max_of_one_grasp_is_its_edge() -> None:
    plant, grasp = Plant(T, 0.1, 1.0, 1.0), Grasp(0.05, 500.0, 1.0)
    box = HandBox((0.05, 0.05), (500.0, 500.0), (1.0, 1.0))
    derivative = without_spring(
        parse_law({"kind": "pd", "stiffness": 1.0, "damping": 1.0}), T
    )
    edge = k_max_over(lambda k: with_spring(derivative, k), plant, box, 5000.0)
    assert edge is not None
    assert (
        alone(plant, grasp, pd(0.9999 * edge, 1.0))
        < 1.0
        < alone(plant, grasp, pd(1.0001 * edge, 1.0))
    )
    assert k_max_over(
        lambda k: with_spring(derivative, k), plant, box, 0.5 * edge
    ) == pytest.approx(0.5 * edge)


def test_a_law_for_any_hand_is_stable_in_every_grasp_of_a_wide_box() -> None:
    """A law passive towards any hand (§2) is stable; PD, B 3, swings in some grasps."""
    box = HandBox((0.002, 2.0), (50.0, 20000.0), (0.01, 5.0))
    demand = Demand((0.05, 0.2), 1.0, (1.0, 1.0), T, 0.99, 1e4)
    assert (
        worst_grasp(
            parse_law("any_hand_d1").compile(T), Plant(T, 0.1, 1.0, 1.0), box
        ).radius
        < 1.0
    )
    judged = judge_grasps(pd(800.0), demand, box, 1)
    assert judged.worst.certified is Certificate.UNSTABLE
    assert "NOT every one stable" in judged.text()


def broken(seeds: range) -> tuple[int, list[int]]:
    """Return how many random boxes are certified, and which hold an unstable grasp."""
    certified, wrong = 0, []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        plant = Plant(
            T,
            10.0 ** rng.uniform(-1.5, 0.0),
            10.0 ** rng.uniform(-1.0, 0.7),
            float(rng.choice([0.0, 1.0, rng.uniform(0.0, 2.0)])),
        )
        unit = plant.mass / T**2
        law = pd(
            10.0 ** rng.uniform(-3.5, -0.5) * unit,
            10.0 ** rng.uniform(-2.5, -0.2) * unit * T,
        )
        middle = [
            10.0 ** rng.uniform(*e) for e in ((-2.5, -0.3), (1.5, 3.5), (-1.0, 0.7))
        ]
        wide = 1.0 + 10.0 ** rng.uniform(-3.0, -0.3)
        box = HandBox(*((value / wide, value * wide) for value in middle))
        if certify_box(law, plant, box, 1500)[0]:
            certified += 1
            within = (
                Grasp(*(rng.uniform(*side) for side in box.sides)) for _ in range(12)
            )
            if max(alone(plant, one, law) for one in (*box.corners(), *within)) >= 1.0:
                wrong.append(seed)
    return certified, wrong


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_no_certificate_of_a_thousand_boxes_is_broken_by_a_grasp() -> None:
    certified, wrong = broken(range(1000))
    assert wrong == []
    assert certified > 300


@pytest.mark.slow
def test_designed_preset_is_certified_in_the_grasp_of_a_stylus() -> None:
    demand = Demand((0.1, 0.1), 1.0, (1.0, 1.0), T, 0.99, 1e4)
    judged = judge_grasps(parse_law("designed_d1").compile(T), demand, STYLUS)
    assert judged.worst.certified is Certificate.CERTIFIED
    for grasp in STYLUS.corners():
        assert (
            alone(Plant(T, 0.1, 1.0, 1.0), grasp, parse_law("designed_d1").compile(T))
            < 1.0
        )


@pytest.mark.parametrize(
    ("sides", "named"),
    [
        (((0.0, 1.0), (1.0, 2.0), (0.0, 1.0)), "mass"),
        (((0.1, 1.0), (3.0, 2.0), (0.0, 1.0)), "stiffness"),
    ],
)
def test_a_box_that_cannot_be_is_refused(
    sides: tuple[tuple[float, float], ...], named: str
) -> None:
    with pytest.raises(ValueError, match=named):
        HandBox(*sides)
    with pytest.raises(ValueError, match="stiffness"):
        Grasp(0.1, 0.0, 1.0)


def test_corners_are_all_ends() -> None:
    assert len(HandBox((0.1, 0.2), (1.0, 2.0), (0.0, 0.0)).corners()) == 4
    assert {one.mass for one in STYLUS.corners()} == set(itertools.chain(STYLUS.mass))


def test_command_tells_k_max_in_the_worst_grasp(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    words = [
        "study",
        "kmax",
        "--law",
        "pd",
        "--gain",
        "1",
        "--delay",
        "1",
        "--json",
        "--out",
        str(tmp_path),
    ]
    assert main([*words, "--grasp", "0.05,500,1"]) == 0
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    plant, grasp = Plant(T, 0.1, 1.0, 1.0), Grasp(0.05, 500.0, 1.0)
    edge = told["k_max_grasp_n_per_m"]
    assert (
        alone(plant, grasp, pd(0.999 * edge, 1.0))
        < 1.0
        < alone(plant, grasp, pd(1.001 * edge, 1.0))
    )
    with pytest.raises(SystemExit):
        main([*words, "--grasp", "0.05,500"])
    assert "MASS,STIFFNESS,DAMPING" in capsys.readouterr().err
