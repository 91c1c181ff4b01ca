"""Two hands and a network: closed forms, poles against simulation, and energy."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nodes.laws import CompiledLaw
from nodes.laws.pd import PD
from nodes.stability.plant import Plant
from sim.experiments.hands_apart import EndGuard, Network, felt, over_delay, play
from sim.stability.two_hands import TwoHands
from tests.support.two_port import loop_radius

T = 0.002
DEVICE = Plant(T, 0.045, 1.0)


def pd(stiffness: float, damping: float = 0.0) -> CompiledLaw:
    return PD(stiffness=stiffness, damping=damping).compile(T)


def kick(k: int) -> float:
    return 1.0 if k < 10 else 0.0


def rest(k: int) -> float:
    del k
    return 0.0


@pytest.mark.parametrize("delay", [0, 3, 10])
def test_a_spring_over_a_network_drags_by_stiffness_times_round_trip(
    delay: int,
) -> None:
    # F₁ = K (x₂ − x₁) with x₂ late by a ticks, and the partner's x₂ late by c behind x₁: −F₁/v → K
    # T (a + c) at ω → 0. At 1 Hz the partner's own mass and damping on the spring add terms of
    # (ωT(a + c))² and of b.
    stiffness = 200.0
    found = felt(DEVICE, pd(stiffness), Network(delay, delay))
    assert found.drag_n_s_per_m == pytest.approx(
        stiffness * T * 2 * delay, abs=0.05 + 0.02 * stiffness * T * 2 * delay
    )
    # The fist of 2 kN/m gives by a tenth of the way, which is felt a round trip late: ωT(a + c) of
    # it, squared, below 2 %.
    assert found.stiffness_n_per_m == pytest.approx(stiffness, rel=0.02)


@pytest.mark.parametrize(("share", "stable"), [(0.97, True), (1.03, False)])
def test_play_swings_where_the_poles_say(share: float, stable: bool) -> None:
    # The edge of two free devices by the poles of the whole loop, computed apart from the player.
    def radius(stiffness: float) -> float:
        law = pd(stiffness, 0.3)
        return loop_radius(
            TwoHands.law_each((law, law), 5, 5), ((0.045, 1.0, 0.0), (0.045, 1.0, 0.0))
        )

    low, high = 10.0, 400.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        # Both drift together freely: a pole at 1 that is not this one.
        low, high = (middle, high) if radius(middle) < 1.0 + 1e-7 else (low, middle)
    run = play(
        (DEVICE, DEVICE), (pd(share * low, 0.3),) * 2, Network(5, 5), (kick, rest), 6000
    )
    apart = run.position[:, 0] - run.position[:, 1]
    assert (np.ptp(apart[-500:]) < np.ptp(apart[2500:3000])) == stable


@settings(max_examples=15)
@given(
    stiffness=st.floats(50.0, 1500.0),
    gain=st.floats(0.0, 1.0),
    there=st.integers(0, 15),
    back=st.integers(0, 15),
    jitter=st.integers(0, 8),
    loss=st.floats(0.0, 0.6),
    seed=st.integers(0, 1000),
)
def test_guards_at_both_ends_make_no_energy_over_any_network(
    stiffness: float,
    gain: float,
    there: int,
    back: int,
    jitter: int,
    loss: float,
    seed: int,
) -> None:
    guard = EndGuard(stiffness, 1.0)
    network = Network(there, back, jitter, loss, seed)
    run = play(
        (DEVICE, DEVICE), (pd(stiffness, gain),) * 2, network, (kick, rest), 1500, guard
    )
    # A guard looks one tick ahead: a tick gives out no more than its force times the change of a
    # step, F²T²/m at either end (nodes/driver/passivity.py), and what was given out too much is
    # owed, so it does not add up.
    most = 2.0 * float(np.abs(run.force).max()) ** 2 * T * T / DEVICE.mass
    assert run.given_out_j.max() <= most + 1e-12
    assert float(np.abs(run.position).max()) < 0.05
    assert float(np.ptp(run.position[-200:], axis=0).max()) < 1e-4


def test_without_a_guard_the_same_network_throws_the_hands() -> None:
    run = play(
        (DEVICE, DEVICE), (pd(300.0, 0.3),) * 2, Network(5, 5), (kick, rest), 1500
    )
    assert float(np.abs(run.position).max()) > 1.0


def test_a_law_each_bears_more_than_one_beside_the_first_device_and_a_damper_still_more() -> (
    None
):
    (near,) = over_delay(DEVICE, 500.0, 1.0, [0], dampers=2)
    (far,) = over_delay(DEVICE, 500.0, 1.0, [2], dampers=5)
    # b/T at no delay, whichever way
    assert near.one_law_n_per_m == pytest.approx(500.0, rel=1e-6)
    assert near.law_each_n_per_m == pytest.approx(500.0, rel=1e-6)
    # b/(T(1 + (a + c)/2))
    assert far.law_each_n_per_m == pytest.approx(1.0 / (T * 3.0), rel=1e-6)
    assert far.one_law_n_per_m is not None
    assert far.law_each_n_per_m is not None
    assert far.damped_n_per_m is not None
    assert far.one_law_n_per_m < far.law_each_n_per_m < far.damped_n_per_m
    # The guard lets the whole stiffness through, to what the fist gives, as above.
    assert far.guarded.stiffness_n_per_m == pytest.approx(500.0, rel=0.02)
    assert math.isfinite(far.guarded.drag_n_s_per_m)
