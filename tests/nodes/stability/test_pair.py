"""Two bodies on one law, exact: against scipy's matrix exponential from event to event."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from nodes.coupling.parameters import PlantParameters
from nodes.laws import CompiledLaw
from nodes.laws.parse import compile_law, parse_law
from nodes.stability.closed_loop import pole_radius, rendered, state_matrix
from nodes.stability.judge import judge
from nodes.stability.k_max import k_max, tolerance, with_spring, without_spring
from nodes.stability.plant import Counterpart, Plant

T = 0.002
PD3 = CompiledLaw((3.0 / T, -3.0 / T))
LAWS = [
    CompiledLaw((0.0,)),
    CompiledLaw((1.0 / T, -1.0 / T)),
    without_spring(
        parse_law({"kind": "paper_optimum", "stiffness": 1.0, "damping": 1.0}), T
    ),
    without_spring(
        parse_law(
            {"kind": "pd_filtered", "stiffness": 1.0, "damping": 1.0, "cutoff": 60.0}
        ),
        T,
    ),
]


def stepped(law: CompiledLaw, plant: Plant) -> float:
    """Return the largest pole of the loop, by one tick from each unit state of both bodies.

    Without a spring to ground, the common pole at 1 is omitted.
    """
    partner = plant.partner
    assert partner is not None
    bodies = [(plant.mass, plant.damping, plant.stiffness, plant.delay)]
    bodies.append(
        (partner.mass, partner.damping, partner.stiffness, plant.delay + partner.later)
    )
    n, flying = max(len(law.taps), 2), math.ceil(max(body[3] for body in bodies)) + 1
    size = 4 + n + 2 * len(law.sections) + flying

    def tick(state: np.ndarray) -> np.ndarray:
        places, seen = state[:4], state[4 : 4 + n]
        memory = state[4 + n : size - flying].reshape(-1, 2)
        forces = state[size - flying :]
        seen = np.append(places[0] - places[2], seen[:-1])
        force = -sum(tap * x for tap, x in zip(law.taps, seen, strict=False))
        after = []
        for (b0, b1, a1, a2), (y1, y2) in zip(law.sections, memory, strict=True):
            y = b0 * seen[0] + b1 * seen[1] - a1 * y1 - a2 * y2
            force -= y
            after += [y, y1]
        all_forces = np.append(force, forces)  # of this tick and those before it
        moved = []
        for (mass, damping, stiffness, delay), at, sign in zip(
            bodies, (places[:2], places[2:]), (1.0, -1.0), strict=True
        ):
            whole, part = int(delay), delay - int(delay)
            at = np.append(at, 0.0)
            for age, duration in ((whole + 1, part), (whole, 1.0 - part)):
                push = sign * all_forces[age]
                matrix = np.array(
                    [
                        [0.0, 1.0, 0.0],
                        [-stiffness / mass, -damping / mass, push / mass],
                        [0.0, 0.0, 0.0],
                    ]
                )
                at[2] = 1.0
                at = expm(matrix * duration * T) @ at
            moved.append(at[:2])
        return np.concatenate([*moved, seen, np.array(after), all_forces[:-1]])

    poles = np.linalg.eigvals(np.array([tick(unit) for unit in np.eye(size)]).T)
    if not plant.anchored:
        poles = np.delete(poles, np.argmin(np.abs(poles - 1.0)))
    return float(np.abs(poles).max())


bodies = st.tuples(
    st.floats(0.02, 0.5),
    st.floats(0.05, 5.0),
    st.sampled_from([0.0, 100.0, 600.0]),
    st.floats(0.0, 2.0),
)


@settings(max_examples=25, deadline=None)
@given(bodies, bodies, st.sampled_from(LAWS), st.floats(50.0, 3000.0))
def test_the_pole_radius_is_that_of_both_bodies(
    first: tuple[float, ...],
    second: tuple[float, ...],
    derivative: CompiledLaw,
    stiffness: float,
) -> None:
    one, other = (
        Plant(T, mass, damping, delay, hand)
        for mass, damping, hand, delay in (first, second)
    )
    law, pair = with_spring(derivative, stiffness), one.paired_with(other)
    # Poles of matrices of up to 15 states, of which a double one is known to the root of the
    # rounding of forces, 1e-7 or so.
    assert pole_radius(law, pair) == pytest.approx(stepped(law, pair), abs=2e-7)


@settings(max_examples=12, deadline=None)
@given(bodies, bodies, st.sampled_from(LAWS))
def test_k_max_is_the_edge_of_both_bodies(
    first: tuple[float, ...], second: tuple[float, ...], derivative: CompiledLaw
) -> None:
    one, other = (
        Plant(T, mass, damping, delay, hand)
        for mass, damping, hand, delay in (first, second)
    )
    pair = one.paired_with(other)
    edge = k_max(derivative, pair).k_max_n_per_m
    if edge is None:
        # No stretch that is stable: neither is what a hand or a finger would do.
        assert all(
            stepped(with_spring(derivative, k), pair) > 1.0 - 1e-7
            for k in (1.0, 30.0, 300.0)
        )
        return
    assert (
        stepped(with_spring(derivative, 0.999 * edge), pair)
        < 1.0
        < stepped(with_spring(derivative, 1.001 * edge), pair)
    )


@pytest.mark.slow
def test_k_max_of_many_pairs() -> None:
    """1000 random pairs: stable 1e-4 below the limit, unstable 1e-4 above it."""
    rng = np.random.default_rng(5)
    for n in range(1000):
        one, other = (
            Plant(
                T,
                10.0 ** rng.uniform(-2, 0),
                10.0 ** rng.uniform(-1.5, 1),
                rng.uniform(0, 3),
                rng.choice([0.0, rng.uniform(0, 800)]),
            )
            for _ in range(2)
        )
        pair, derivative = one.paired_with(other), LAWS[n % len(LAWS)]
        edge = k_max(derivative, pair).k_max_n_per_m
        if edge is not None:
            low, high = (
                stepped(with_spring(derivative, part * edge), pair)
                for part in (0.9999, 1.0001)
            )
            assert low < 1.0 < high, (pair, derivative, edge)


def test_two_equal_devices_are_one_of_half_the_mass_and_undamped_ones_a_reduced_mass() -> (
    None
):
    """Common motion does not reach the law: the limit equals one device's."""
    one = Plant(T, 0.1, 1.0, 0.7, 200.0)
    half = Plant(T, 0.05, 0.5, 0.7, 100.0)
    found, expected = (
        k_max(PD3, plant).k_max_n_per_m for plant in (one.paired_with(one), half)
    )
    assert found == pytest.approx(expected, rel=1e-9)
    free = Plant(T, 0.3, 0.0).with_tool(0.02)
    assert k_max(PD3, free) == k_max(PD3, Plant(T, 0.3 * 0.02 / 0.32, 0.0))
    assert state_matrix(PD3, free) == pytest.approx(
        state_matrix(PD3, Plant(T, 0.3 * 0.02 / 0.32, 0.0))
    )


def test_a_tool_with_all_the_mass_is_a_wall_and_a_device_with_all_of_it_leaves_the_tool() -> (
    None
):
    device = Plant(T, 0.1, 1.0, 0.3)
    wall = k_max(PD3, device).k_max_n_per_m
    assert k_max(PD3, device.with_tool(1e7)).k_max_n_per_m == pytest.approx(
        wall, rel=1e-6
    )
    still = Plant(T, 1e7, 1.0, 0.3).with_tool(0.1, 1.0)
    assert k_max(PD3, still).k_max_n_per_m == pytest.approx(wall, rel=1e-6)


def test_the_delay_of_a_loop_and_of_its_device_are_told_apart() -> None:
    """A tool feels the loop's delay without the device's; a partner its own."""
    tool = PlantParameters(
        mass=0.1, damping=1.0, device_delay=1.2, tool_mass=0.05, tool_damping=0.4
    ).at(T, 0.5)
    assert tool == Plant(T, 0.1, 1.0, 1.7, 0.0, Counterpart(0.05, 0.4, 0.0, -1.2))
    other = {
        "partner_mass": 0.2,
        "partner_damping": 2.0,
        "partner_stiffness": 50.0,
        "partner_later": -3.0,
    }
    pair = PlantParameters(mass=0.1, **other, device_delay=1.0).at(T, 0.5)
    # nothing acts before it is handed over
    assert pair.other == Plant(T, 0.2, 2.0, 0.0, 50.0)
    with pytest.raises(ValueError, match="delay = -1"):
        Plant(T, 0.1, 1.0, 0.5, partner=Counterpart(0.1, later=-1.5))


@pytest.mark.parametrize(
    ("later", "delay"), [(-0.5, 0.0), (-0.5 - 9e-13, 0.0), (-0.25, 0.25), (1.0, 1.5)]
)
def test_a_partner_s_delay_is_later_and_not_negative_by_rounding(
    later: float, delay: float
) -> None:
    other = Plant(T, 0.1, 1.0, 0.5, partner=Counterpart(0.1, later=later)).other
    assert other == Plant(T, 0.1, 0.0, delay)
    with pytest.raises(ValueError, match="delay"):
        Plant(T, 0.1, 1.0, 0.5, partner=Counterpart(0.1, later=-0.5 - 2e-12))


@pytest.mark.parametrize(
    ("stiffness", "others", "anchored"),
    [(0.0, None, False), (1.0, None, True), (0.0, 0.0, False), (0.0, 1.0, True)],
)
def test_a_spring_of_either_body_ties_both_to_ground(
    stiffness: float, others: float | None, anchored: bool
) -> None:
    partner = None if others is None else Counterpart(0.1, stiffness=others)
    assert Plant(T, 0.1, 1.0, 0.5, stiffness, partner).anchored is anchored


def test_judgement_tolerance_and_passivity_know_the_partner() -> None:
    law = compile_law(parse_law({"kind": "pd", "stiffness": 400.0, "damping": 0.1}), T)
    device = Plant(T, 0.1, 1.0)
    alone, tool = judge(law, device), judge(law, device.with_tool(0.004, 0.02))
    assert alone is not None
    assert tool is not None
    assert alone.stable
    assert not tool.stable
    # The longest delay is found for both bodies: it is the edge of the stepped loop.
    soft = compile_law(parse_law({"kind": "pd", "stiffness": 30.0, "damping": 0.1}), T)
    heavy = replace(device, mass=0.3).with_tool(0.05, 0.2)
    margins = tolerance(soft, heavy)
    assert margins is not None
    assert margins.delay_max_ticks is not None
    edges = [
        stepped(soft, replace(heavy, delay=part * margins.delay_max_ticks))
        for part in (0.999, 1.001)
    ]
    assert edges[0] < 1.0 < edges[1]
    # Any hand and anything on the tool: b b'/(b + b') in place of b (THEORY.md §18).
    passive = rendered(law, device).passive_scale
    assert passive is not None
    assert rendered(law, device.with_tool(0.05, 0.25)).passive_scale == pytest.approx(
        0.2 * passive
    )
    assert rendered(law, device.with_tool(0.05)).passive_scale == 0.0
