"""The flexible device: against the rigid one, an integrated motion, the analytic response."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from nodes.laws import CompiledLaw
from nodes.laws.parse import parse_law
from nodes.stability.closed_loop import pole_radius
from nodes.stability.flexible import FlexiblePlant, flexible_radius
from nodes.stability.plant import Plant, held_plant

T = 0.002
PD = CompiledLaw((1500.0, -1000.0))


@pytest.mark.parametrize("delay", [0.0, 0.4, 1.0, 2.3])
@pytest.mark.parametrize("hand", [0.0, 300.0])
def test_without_joint_and_lag_it_is_the_rigid_device(
    delay: float, hand: float
) -> None:
    plant = FlexiblePlant(0.1, 1.0, delay, hand)
    rigid = held_plant(Plant(T, 0.1, 1.0, delay, hand))
    whole, numerator, denominator = plant.rational(T)
    assert whole == rigid.whole
    # Rounding of a difference of determinants of size 4.
    assert denominator == pytest.approx(rigid.denominator, abs=1e-13)
    assert numerator == pytest.approx(rigid.numerator, abs=1e-12 * T * T / 0.1)
    filtered = parse_law(
        {"kind": "pd_filtered", "stiffness": 500.0, "damping": 2.0, "cutoff": 50.0}
    ).compile(T)
    for law in (PD, filtered):
        assert flexible_radius(law, T, plant) == pytest.approx(
            pole_radius(law, Plant(T, 0.1, 1.0, delay, hand)), abs=1e-9
        )


def test_a_stiff_joint_and_a_short_lag_tend_to_the_rigid_device() -> None:
    """The dominant pole tends to the rigid device's in proportion to the lag."""
    rigid = flexible_radius(PD, T, FlexiblePlant(0.1, 1.0, 1.2))
    off = [
        flexible_radius(PD, T, FlexiblePlant(0.1, 1.0, 1.2, lag=lag)) - rigid
        for lag in (1e-5, 1e-6)
    ]
    assert off[0] / off[1] == pytest.approx(10.0, rel=0.02)
    joint = FlexiblePlant(0.1, 1.0, 1.2, share=0.3, frequency=20000.0, loss=0.5)
    assert flexible_radius(PD, T, joint) == pytest.approx(rigid, abs=1e-4)


def test_response_is_rigid_body_plus_mode() -> None:
    """Undamped and free: x/F = 1/(m s²) + (m2/m1)/(m (s² + ω²)) under a held force."""
    plant = FlexiblePlant(0.2, 0.0, share=0.3, frequency=57.0)
    whole, numerator, denominator = plant.rational(T)
    pulse = 2.0 * math.pi * 57.0
    z = np.exp(1j * np.linspace(0.05, 3.0, 40))
    rigid = T * T / 0.2 * (z + 1.0) / (2.0 * (z - 1.0) ** 2)
    c = math.cos(pulse * T)
    mode = (
        0.3 / 0.7 / 0.2 * (1.0 - c) / pulse**2 * (z + 1.0) / (z * z - 2.0 * c * z + 1.0)
    )
    seen = np.polyval(numerator, z) / (z ** (whole + 1) * np.polyval(denominator, z))
    assert seen == pytest.approx(rigid + mode, rel=1e-8)


def test_one_tick_is_the_integrated_motion() -> None:
    plant = FlexiblePlant(
        0.1, 1.0, 0.35, 200.0, lag=0.003, share=0.4, frequency=30.0, loss=0.02
    )
    whole, step, new, old = plant.held(T)
    matrix, push = plant.continuous()
    start = np.array([1e-3, 0.1, -2e-3, -0.05, 0.3])
    state, begin = start, 0.0
    for end, force in ((0.35 * T, 0.7), (T, -1.1)):

        def slope(_: float, y: np.ndarray, force: float = force) -> np.ndarray:
            return np.asarray(matrix @ y + push * force)

        state = solve_ivp(slope, (begin, end), state, rtol=1e-11, atol=1e-14).y[:, -1]
        begin = end
    assert whole == 0
    # The integrator's tolerance, over some ten steps.
    assert step @ start + new * -1.1 + old * 0.7 == pytest.approx(
        state, rel=1e-8, abs=1e-12
    )


def test_a_law_for_the_rigid_device_can_be_unstable_with_a_joint() -> None:
    law = CompiledLaw((8000.0, -7400.0))
    assert flexible_radius(law, T, FlexiblePlant(0.1, 1.0, 0.2)) < 1.0
    assert (
        flexible_radius(
            law, T, FlexiblePlant(0.1, 1.0, 0.2, share=0.5, frequency=120.0, loss=0.02)
        )
        > 1.0
    )


def test_bad_devices_are_refused() -> None:
    with pytest.raises(ValueError, match=r"mass = 0\.0"):
        FlexiblePlant(0.0, 1.0)
    with pytest.raises(ValueError, match="share < 1"):
        FlexiblePlant(0.1, 1.0, share=1.0)
    with pytest.raises(ValueError, match="lag = -1"):
        FlexiblePlant(0.1, 1.0, lag=-1.0)
