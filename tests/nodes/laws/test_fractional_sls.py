"""The fractional standard linear solid: its limits are known laws, and its passivity is not that of ω_N once delayed."""

from __future__ import annotations

import math

import numpy as np
import pytest

from nodes.laws.fractional_sls import FractionalSLS
from nodes.laws.pd_alpha import PDAlpha
from nodes.laws.pd_filtered import PDFiltered
from nodes.stability.effective_damping import damping_needed

T = 0.002


def test_without_relaxation_it_is_kelvin_and_voigts() -> None:
    """τ → 0: what is left of the arm differs by (τ/T)^α of it, here 10⁻⁶."""
    solid = FractionalSLS(stiffness=900.0, damping=0.5, order=0.6, relaxation=T * 1e-10, taps=12).compile(T)
    known = PDAlpha(stiffness=900.0, damping=0.5, order=0.6, taps=12, gains="physical").compile(T)
    assert solid.taps == pytest.approx(known.taps, rel=2e-6)


def test_of_order_one_it_is_a_velocity_behind_a_filter() -> None:
    """B D/(1 + τD) by backward differences: a pole at c/(1 + c); its response is kept to 200 taps, 0.5^200 of it left."""
    relaxation = T
    solid = FractionalSLS(stiffness=900.0, damping=3.0, order=1.0, relaxation=relaxation, taps=200).compile(T)
    pole = relaxation / (relaxation + T)
    known = PDFiltered(stiffness=900.0, damping=3.0, cutoff=-math.log(pole) / (2.0 * math.pi * T)).compile(T)
    z = np.exp(1j * np.linspace(0.01, np.pi, 50))
    assert solid.response(z) == pytest.approx(known.response(z), rel=1e-12)


@pytest.mark.parametrize("order", [0.3, 0.7])
def test_the_arm_keeps_its_equation(order: float) -> None:
    """A + τ^α D^α A = B_α D^α x by the sums themselves, on any signal."""
    law = FractionalSLS(stiffness=0.0, damping=2.0, order=order, relaxation=3.0 * T, taps=60).compile(T)
    weights = np.array([math.prod((m - 1.0 - order) / m for m in range(1, n + 1)) for n in range(60)])
    x = np.random.default_rng(1).normal(size=60)
    force = np.convolve(x, law.taps)[:60]
    left = force + 3.0**order * np.convolve(force, weights)[:60]
    assert left == pytest.approx(2.0 * T**-order * np.convolve(x, weights)[:60], rel=1e-9)


def test_the_condition_at_nyquist_is_passivity_without_delay_and_not_with_a_tick() -> None:
    law = FractionalSLS(stiffness=400.0, damping=0.4, order=0.6, relaxation=2.0 * T, taps=400).compile(T)
    at_nyquist = 0.5 * T * law.h_nyquist
    # The cut after 400 taps ripples by what it leaves of the response.
    assert damping_needed(law, T, 0.0) == pytest.approx(at_nyquist, rel=1e-2)
    assert damping_needed(law, T, 1.0) > 1.2 * at_nyquist
