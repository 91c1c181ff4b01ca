"""Realisations of D^α in frequency: powers, Padé, zeros and poles by mpmath and numpy."""

from __future__ import annotations

import cmath
import math

import mpmath
import numpy as np
import pytest

from nodes.laws.derivatives import realise
from nodes.laws.derivatives.bdf import lubich
from nodes.laws.derivatives.exponentials import exponentials
from nodes.laws.derivatives.log_binned import bins
from sim.lab.charts.derivative_errors import best_delay, response
from tests.support.realisations import EPS, T, apply, at, size

# --- frequency domain
# ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("order", [0.3, 0.8, 1.5, 2.7, 3.47])
def test_gl_has_the_delay_of_half_alpha(order: float) -> None:
    angles = np.geomspace(0.05, 2.5, 50)
    relative = (
        response(realise("gl", order, 4000, 1.0), angles) / (1j * angles) ** order
    )
    # Exact for infinite memory; the cut adds |c_n|/sin(θ/2) at most, 4000^−1.3/0.025 = 1e−3 of θ^α
    # for α = 0.3.
    assert best_delay(relative, angles) == pytest.approx(0.5 * order, abs=0.01)


@pytest.mark.parametrize("fraction", [0.02, 0.2, 0.7])
@pytest.mark.parametrize("order", [0.3, 0.9, 1.5, 3.47])
@pytest.mark.parametrize("degree", [2, 3, 4, 5, 6])
def test_bdf_is_the_power_of_its_polynomial(
    degree: int, order: float, fraction: float
) -> None:
    law = lubich(order, 3000, 1.0, degree)
    w = cmath.exp(-1j * math.pi * fraction)
    symbol = sum((1.0 - w) ** j / j for j in range(1, degree + 1)) ** order
    # The tail of a monotone series times e^{−jmθ} is at most its first term over sin(θ/2).
    cut = abs(law.taps[-1]) / math.sin(0.5 * math.pi * fraction)
    assert abs(at(law, fraction) - symbol) <= cut + 3000 * EPS * size(law)


@pytest.mark.parametrize("degree", [1, 4, 9])
@pytest.mark.parametrize("order", [0.3, 0.9, 1.5, 3.47])
@pytest.mark.parametrize(
    ("kind", "left"), [("tustin_cfe", 1.0), ("al_alaoui_cfe", 1.0 / 7.0)]
)
def test_continued_fraction_is_the_pade_approximant(
    kind: str, left: float, order: float, degree: int
) -> None:
    whole, fraction = math.floor(order), order - math.floor(order)
    law = realise(kind, order, degree + 1, T)
    with mpmath.workdps(60):
        a, beta = mpmath.mpf(left), mpmath.mpf(fraction)
        binomials = [
            ((-1) ** m * mpmath.binomial(beta, m), a**m * mpmath.binomial(-beta, m))
            for m in range(2 * degree + 1)
        ]
        series = [
            sum(binomials[j][0] * binomials[m - j][1] for j in range(m + 1))
            for m in range(2 * degree + 1)
        ]
        top, bottom = mpmath.pade(series, degree, degree)
        for angle in (0.003, 0.1, 0.5, 1.0):
            w = mpmath.expj(-mpmath.pi * angle)
            exact = sum(c * w**m for m, c in enumerate(top)) / sum(
                c * w**m for m, c in enumerate(bottom)
            )
            exact *= ((1 + a) / T) ** beta * ((1 - w) / T) ** whole
            # (1 − w)^k cancels k digits' worth of the sections' rounding at low frequency.
            rounding = 1e3 * EPS * size(law)
            assert abs(at(law, angle) - complex(exact)) <= rounding + 1e-9 * abs(
                complex(exact)
            )


def test_tustin_gain_at_nyquist_grows_as_n_to_two_beta() -> None:
    for degree in (3, 9, 27):
        gain = realise("tustin_cfe", 0.5, degree + 1, T).h_nyquist * math.sqrt(0.5 * T)
        # [n/n] Padé approximant of √((1+x)/(1−x)) at x = 1: 2n + 1 exactly.
        assert gain == pytest.approx(2.0 * degree + 1.0, rel=1e-10)


@pytest.mark.parametrize("kind", ["oustaloup_tustin", "oustaloup_matched"])
@pytest.mark.parametrize("order", [0.4, 1.4])
def test_oustaloup_against_zeros_and_poles(kind: str, order: float) -> None:
    half, fraction, whole = 4, order - math.floor(order), math.floor(order)
    law = realise(kind, order, 2 * half + 2, T)
    high = math.pi / T
    low = high / 10.0 ** (0.5 * (2 * half + 1))
    spread = (np.arange(-half, half + 1) + half + 0.5) / (2 * half + 1)
    zeros = -low * (high / low) ** (spread - 0.5 * fraction / (2 * half + 1))
    poles = -low * (high / low) ** (spread + 0.5 * fraction / (2 * half + 1))
    if kind == "oustaloup_tustin":
        # Tustin's rule of both, z = (2/T + s)/(2/T − s)
        zeros, poles = ((2.0 / T + s) / (2.0 / T - s) for s in (zeros, poles))
    else:
        zeros, poles = np.exp(zeros * T), np.exp(poles * T)

    def exact(angle: float) -> complex:
        z = cmath.exp(1j * angle)
        return (
            complex(np.prod((z - zeros) / (z - poles))) * ((1.0 - 1.0 / z) / T) ** whole
        )

    middle = math.sqrt(low * high) * T
    gain = (middle / T) ** fraction / abs(
        exact(middle) / ((1.0 - cmath.exp(-1j * middle)) / T) ** whole
    )
    for angle in (0.002, 0.05, 0.5, 3.0):
        # Partial fractions and product differ by rounding, of the size of the largest gain.
        assert abs(at(law, angle / math.pi) - gain * exact(angle)) <= 1e3 * EPS * size(
            law
        )
    # The band reaches from Nyquist down half a decade per pair: in its middle the slope is right
    # within its ripple.
    assert abs(at(law, middle / math.pi)) == pytest.approx(
        (middle / T) ** order, rel=1e-3
    )


@pytest.mark.parametrize("order", [0.2, 0.5, 0.9])
@pytest.mark.parametrize("memory", [8, 100, 2000])
def test_exponentials_keep_the_weights_of_gl(order: float, memory: int) -> None:
    law = exponentials(order, memory, 1.0)
    impulse = np.eye(1, memory)[0]
    weights = np.cumsum(apply(law, impulse))
    exact = [
        float(mpmath.rf(1 - order, m) / mpmath.factorial(m)) for m in range(memory)
    ]
    # The first four are kept; h = 0.9 and all rates below 0.05/N on one pole leave 1 % of the
    # weight itself at age N.
    assert weights[:4] == pytest.approx(exact[:4], rel=1e-9)
    assert weights == pytest.approx(exact, rel=0.03)
    # O(log N): one exponential per 0.9 nepers of memory, two to a section.
    assert len(law.sections) <= 0.5 * (math.log(memory) / 0.9 + 8.0)


@pytest.mark.parametrize("taps", [17, 100, 1000])
def test_log_bins_keep_the_sum_and_the_newest(taps: int) -> None:
    law, plain = realise("log_binned", 0.5, taps, 1.0), realise("gl", 0.5, taps, 1.0)
    assert math.fsum(law.taps) == pytest.approx(math.fsum(plain.taps), abs=taps * EPS)
    assert law.taps[:16] == plain.taps[:16]
    edges = bins(taps)
    assert [m for first, last in edges for m in range(first, last)] == list(range(taps))
    assert len(edges) <= 16 + 8 * math.ceil(math.log2(max(taps, 17) / 16))
    assert all((last - first) <= max(1, first // 8) for first, last in edges)


@pytest.mark.parametrize("order", [0.3, 0.7])
def test_least_squares_cannot_be_improved(order: float) -> None:
    law = realise("least_squares", order, 9, 1.0)
    angles = math.pi * np.geomspace(1e-4, 0.5, 240)
    w = np.exp(-1j * angles)
    residual = response(law, angles) / (1j * angles) ** order - 1.0
    poles = np.exp(-np.geomspace(1e-4, 2.0, 8))
    for basis in (1.0, w, *(w / (1.0 - p * w) for p in poles)):
        column = (1.0 - w) * basis / (1j * angles) ** order
        slope = abs(np.vdot(column, residual).real)
        # At the minimum the residual is orthogonal to all that was fitted, up to the rounding of
        # cond ≈ 300 squared.
        assert slope <= 1e-8 * float(np.linalg.norm(column))
