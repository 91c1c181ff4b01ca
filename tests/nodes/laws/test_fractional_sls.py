"""The fractional standard linear solid: limits are known laws; its passivity with delay."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from nodes.cli.main import main
from nodes.laws.derivatives.relaxation import exponentials, step_answer
from nodes.laws.fractional_sls import FractionalSLS
from nodes.laws.pd_alpha import PDAlpha
from nodes.laws.pd_filtered import PDFiltered
from nodes.stability.effective_damping import damping_needed

T = 0.002


def test_without_relaxation_it_is_kelvin_and_voigts() -> None:
    """τ → 0: the remaining difference is (τ/T)^α, here 10⁻⁶."""
    solid = FractionalSLS(
        stiffness=900.0, damping=0.5, order=0.6, relaxation=T * 1e-10, taps=12
    ).compile(T)
    known = PDAlpha(
        stiffness=900.0, damping=0.5, order=0.6, taps=12, gains="physical"
    ).compile(T)
    assert solid.taps == pytest.approx(known.taps, rel=2e-6)


def test_of_order_one_it_is_a_velocity_behind_a_filter() -> None:
    """B D/(1 + τD) by backward differences: pole c/(1 + c), 200 taps leave 0.5^200."""
    relaxation = T
    solid = FractionalSLS(
        stiffness=900.0, damping=3.0, order=1.0, relaxation=relaxation, taps=200
    ).compile(T)
    pole = relaxation / (relaxation + T)
    known = PDFiltered(
        stiffness=900.0, damping=3.0, cutoff=-math.log(pole) / (2.0 * math.pi * T)
    ).compile(T)
    z = np.exp(1j * np.linspace(0.01, np.pi, 50))
    assert solid.response(z) == pytest.approx(known.response(z), rel=1e-12)


@pytest.mark.parametrize("order", [0.3, 0.7])
def test_the_arm_keeps_its_equation(order: float) -> None:
    """A + τ^α D^α A = B_α D^α x by direct sums, for any signal."""
    law = FractionalSLS(
        stiffness=0.0, damping=2.0, order=order, relaxation=3.0 * T, taps=60
    ).compile(T)
    weights = np.array(
        [math.prod((m - 1.0 - order) / m for m in range(1, n + 1)) for n in range(60)]
    )
    x = np.random.default_rng(1).normal(size=60)
    force = np.convolve(x, law.taps)[:60]
    left = force + 3.0**order * np.convolve(force, weights)[:60]
    assert left == pytest.approx(
        2.0 * T**-order * np.convolve(x, weights)[:60], rel=1e-9
    )


ORDERS = st.floats(0.05, 1.0)
RELAXATIONS = st.floats(0.5 * T, 10.0)


# the last orders below 1: all the density lies in one sample, then in a few
@settings(max_examples=25, deadline=None)
@given(ORDERS, RELAXATIONS, st.floats(0.0, 2000.0))
@example(order=1.0 - 2.0**-53, relaxation=0.001, stiffness=0.0)
@example(order=1.0 - 2.0**-53, relaxation=1.0, stiffness=0.0)
@example(order=1.0 - 1e-12, relaxation=0.3, stiffness=0.0)
@example(order=1.0 - 1e-6, relaxation=0.3, stiffness=0.0)
@example(order=0.999, relaxation=0.02, stiffness=0.0)
@example(order=0.99, relaxation=0.02, stiffness=0.0)
def test_with_its_whole_memory_it_is_the_fraction_and_relaxes(
    order: float, relaxation: float, stiffness: float
) -> None:
    """(B/τ^α) c G/(1 + c G) on the unit circle; H(1) is K, where eight taps kept 87 %."""
    law = FractionalSLS(
        stiffness=stiffness, damping=2.0, order=order, relaxation=relaxation
    ).compile(T)
    z = np.exp(
        1j * np.concatenate([np.geomspace(1e-4, 0.1, 40), np.linspace(0.1, np.pi, 80)])
    )
    spring, share, g = (
        2.0 / relaxation**order,
        (relaxation / T) ** order,
        (1.0 - 1.0 / z) ** order,
    )
    exact = stiffness + spring * share * g / (1.0 + share * g)
    # Two exponentials in each cell of 1.8 of ln s leave at most 0.6 % of the arm's own stiffness
    # (tried at 40 pairs).
    assert np.abs(law.response(z) - exact).max() <= 0.01 * spring
    assert law.h1 == pytest.approx(stiffness, abs=1e-6 * (spring + stiffness))
    assert law.stable_sections()


@settings(max_examples=20, deadline=None)
@given(st.floats(0.05, 0.999), RELAXATIONS)
def test_the_exponentials_are_positive_and_sum_to_the_first_answer(
    order: float, relaxation: float
) -> None:
    share = (relaxation / T) ** order
    poles, weights = exponentials(order, share)
    assert min(weights) > 0.0
    assert max(poles) < 1.0
    # The density's integral is s_0 = c/(1 + c), but for the part that is gone within a tick.
    assert sum(weights) == pytest.approx(step_answer(order, share, 1)[0], rel=0.02)


def test_a_maxwell_element_lets_go() -> None:
    """0.1 s, order 1, one section: after 1 s e^−10 is left, exactly p^501 of its first answer."""
    law = FractionalSLS(stiffness=0.0, damping=50.0, order=1.0, relaxation=0.1).compile(
        T
    )
    assert len(law.sections) == 1
    ((b0, b1, a1, a2),) = law.sections
    force, before, held = 0.0, 0.0, []
    for k in range(501):
        force, before = b0 + (b1 if k else 0.0) - a1 * force - a2 * before, force
        held.append(force)
    pole = 0.1 / (0.1 + T)
    assert held[0] == pytest.approx(500.0 * pole, rel=1e-12)
    assert held[500] == pytest.approx(500.0 * pole**501, rel=1e-9)


def test_the_condition_at_nyquist_is_passivity_with_the_whole_memory_and_no_delay() -> (
    None
):
    """Each exponential's share of f, (t − cos θ)/(1 − 2 t cos θ + t²), rises up to ω_N."""
    for order in (0.3, 0.6, 0.9, 1.0):
        law = FractionalSLS(
            stiffness=400.0, damping=0.4, order=order, relaxation=2.0 * T
        ).compile(T)
        at_nyquist = 0.5 * T * law.h_nyquist
        # `damping_needed` ends at the largest of a grid that is refined to 1e-9; the exact first
        # answers move it by their fit.
        assert damping_needed(law, T, 0.0) == pytest.approx(at_nyquist, rel=2e-3)
        assert damping_needed(law, T, 1.0) > 1.2 * at_nyquist


def test_a_short_memory_needs_more_than_the_condition_at_nyquist() -> None:
    """A case over 10 % above it, below ω_N: K 0, relaxation 3.4 ticks, three taps."""
    law = FractionalSLS(
        stiffness=0.0, damping=1.0, order=1.0, relaxation=3.4 * T, taps=3
    ).compile(T)
    at_nyquist = 0.5 * T * law.h_nyquist
    theta = np.linspace(1e-3, np.pi, 20001)
    z = np.exp(1j * theta)
    need = T * np.real(law.response(z) / (1.0 - z))
    assert damping_needed(law, T, 0.0) == pytest.approx(need.max(), rel=1e-6)
    assert need.max() > 1.1 * at_nyquist
    assert theta[np.argmax(need)] < 0.8 * np.pi


SHOWN = [(0.0, ", taps: 8", True), (1000.0, "", False), (20000.0, ", taps: 8", False)]


@pytest.mark.parametrize(("stiffness", "taps", "warned"), SHOWN)
def test_law_show_warns_of_what_a_short_memory_leaks(
    stiffness: float, taps: str, warned: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    """Eight taps of a 0.1 s Maxwell element keep 427 N/m for ever."""
    law = (
        f"{{kind: fractional_sls, stiffness: {stiffness}, damping: 49.0, order: 1.0, relaxation:"
        f" 0.1{taps}}}"
    )
    assert main(["law", "show", law]) == 0
    assert ("a short memory leaks" in capsys.readouterr().out) is warned


def test_a_maxwell_element_alone_is_no_wall(capsys: pytest.CaptureFixture[str]) -> None:
    assert (
        main(
            [
                "law",
                "show",
                (
                    "{kind: fractional_sls, stiffness: 0.0, damping: 49.0, order: 1.0, relaxation:"
                    " 0.1}"
                ),
            ]
        )
        == 2
    )
    assert "renders H(1) = 0 N/m" in capsys.readouterr().err
