"""Realisations of D^α at rest and at their limit: leaks, start-up, known failures."""

from __future__ import annotations

import cmath
import math

import mpmath
import numpy as np
import pytest

from nodes.laws.derivatives import realise
from nodes.laws.derivatives.bdf import lubich
from nodes.laws.derivatives.cfe import whole_order
from sim.lab.charts.derivative_errors import analyse, largest_pole
from tests.support.realisations import BDF, EPS, LENGTH, RECURSIVE, T, apply, at, size

# --- leaks and start-up
# ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("order", [0.1, 0.5, 0.9, 1.3, 1.9, 2.5, 3.47])
@pytest.mark.parametrize("taps", [4, 50, 1000])
def test_gl_leaks_as_the_binomial_sum(order: float, taps: int) -> None:
    leak = realise("gl", order, taps, T).h1 * T**order
    exact = float(mpmath.gammaprod([taps - order], [1 - order, taps]))
    assert leak == pytest.approx(exact, abs=taps * EPS * 2.0**order)
    if taps == 1000:
        # (nT)^−α/Γ(1−α), in units of T^−α, with corrections of order α(α+1)/n.
        assert exact == pytest.approx(
            float((taps - 1) ** -order * mpmath.rgamma(1 - order)),
            rel=order * (order + 1.0) / 1000,
        )
        assert (exact > 0.0) == (order < 1.0 or 2.0 < order < 3.0)


@pytest.mark.parametrize(
    "kind", ["gl_leak_corrected", "l1", "exponentials", "least_squares"]
)
@pytest.mark.parametrize("order", [0.3, 0.9, 1.5, 3.47])
def test_leak_free_laws_give_nothing_for_a_constant(kind: str, order: float) -> None:
    law = realise(kind, order, LENGTH[kind], 1.0)
    # The slowest pole of a recursive one magnifies rounding by 1/(1 − p) <= 1e4.
    tolerance = EPS * (64 if not law.sections else 1e6) * size(law)
    assert abs(law.h1) <= tolerance


@pytest.mark.parametrize("kind", RECURSIVE)
def test_integer_part_split_off_leaves_no_leak(kind: str) -> None:
    assert abs(realise(kind, 1.5, 11, 1.0).h1) <= 1e6 * EPS
    if kind != "least_squares":
        assert realise(kind, 0.5, 11, 1.0).h1 > 1e-3


def test_leak_correction_pays_above_order_one_and_costs_below() -> None:
    def error(kind: str, order: float, taps: int) -> float:
        return analyse(kind, order, taps, T)["error_aligned"]

    for taps in (4, 8, 16, 50):
        assert error("gl_leak_corrected", 1.5, taps) < error("gl", 1.5, taps)
    for taps in (50, 200, 1000):
        assert error("gl_leak_corrected", 0.5, taps) > error("gl", 0.5, taps)


@pytest.mark.parametrize("order", [0.3, 0.5, 0.8])
def test_held_offset_decays_as_a_power(order: float) -> None:
    output = apply(realise("gl", order, 3000, T), np.ones(2000))
    exact = (T * 2000) ** -order / math.gamma(1.0 - order)
    # Gamma(N−α)/Gamma(N) against N^−α: relative correction α(α+1)/2N, N = 2000.
    assert output[-1] == pytest.approx(exact, rel=1.01 * order * (order + 1.0) / 4000)
    # Pre-filled with the first sample, a leak-free law starts from zero (Caputo).
    for kind in ("l1", "gl_leak_corrected"):
        law = realise(kind, order, 64, T)
        filled = apply(law, np.ones(200))[64:]
        assert np.max(np.abs(filled)) <= 200 * EPS * size(law)


# --- what breaks, and how loudly
# --------------------------------------------------------------------------------------


def fraction_response(
    zeros: list[complex], poles: list[complex], z: complex
) -> complex:
    return math.prod((z - a for a in zeros), start=1.0 + 0j) / math.prod(
        (z - p for p in poles), start=1.0 + 0j
    )


@pytest.mark.parametrize("order", [1.2, 1.5, 1.9, 2.5])
@pytest.mark.parametrize("degree", [1, 3, 9])
def test_tustin_expanded_for_the_whole_order_is_unstable(
    order: float, degree: int
) -> None:
    _, poles = whole_order(order, degree, 1.0)
    assert max(map(abs, poles)) > 1.0
    assert largest_pole(realise("tustin_cfe", order, degree + 1, T)) < 1.0
    # For the fraction alone the same expansion is stable, and the same as the Gauss–Jacobi form.
    zeros, poles = whole_order(order - math.floor(order), degree, 1.0)
    assert max(map(abs, poles)) < 1.0
    z = cmath.exp(0.3j)
    expanded = fraction_response(zeros, poles, z) * (2.0 / T) ** (
        order - math.floor(order)
    )
    assert at(
        realise("tustin_cfe", order - math.floor(order), degree + 1, T), 0.3 / math.pi
    ) == pytest.approx(expanded, rel=1e-9)


@pytest.mark.parametrize("order", [1.2, 1.5, 1.8])
def test_al_alaoui_expanded_for_the_whole_order_is_stable_but_wrong_at_low_frequency(
    order: float,
) -> None:
    degree, angle = 5, 0.002 * math.pi
    zeros, poles = whole_order(order, degree, 1.0 / 7.0)
    assert max(map(abs, poles)) < 1.0
    z = cmath.exp(1j * angle)
    wanted = (1j * angle) ** order
    whole = abs(
        fraction_response(zeros, poles, z) * (8.0 / 7.0) ** order / wanted - 1.0
    )
    split = abs(
        at(realise("al_alaoui_cfe", order, degree + 1, 1.0), 0.002) / wanted - 1.0
    )
    assert whole > 1.0
    assert split < 0.6 * whole
    assert abs(fraction_response(zeros, poles, 1.0)) > 1e-4
    assert abs(realise("al_alaoui_cfe", order, degree + 1, 1.0).h1) < 1e-12


@pytest.mark.parametrize("order", [0.5, 1.5])
def test_accuracy_near_nyquist_is_paid_with_gain_there(order: float) -> None:
    figures = [analyse(kind, order, 2000, T) for kind in ("gl", *BDF)]
    error = [
        abs(
            at(realise(kind, order, 2000, T), 0.3) / (0.3j * math.pi / T) ** order - 1.0
        )
        for kind in ("gl", *BDF)
    ]
    assert error == sorted(error, reverse=True)
    for degree, figure in zip(range(1, 7), figures, strict=True):
        exact = (sum(2.0**j / j for j in range(1, degree + 1)) / 2.0) ** order
        # Cut after 2000 taps: |c_n|/2 more or less.
        assert figure["nyquist_gain"] == pytest.approx(exact, rel=1e-3)


def test_bdf7_would_grow_without_bound() -> None:
    with pytest.raises(ValueError, match=r"degree = 7: .* 2 to 6"):
        lubich(0.5, 100, T, 7)
    polynomial = np.poly1d([0.0])
    for j in range(1, 8):
        polynomial = polynomial + np.poly1d([-1.0, 1.0]) ** j / j
    roots = np.abs(polynomial.roots)
    # A zero inside the unit disc (besides w = 1 on it): the power series of any fractional power
    # grows.
    assert np.min(roots) < 1.0 - 1e-6
