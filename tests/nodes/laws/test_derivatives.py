"""One contract for every registered realisation of D^α, and each of the known failures reproduced.

Oracles: Mittag-Leffler functions and Gamma ratios by mpmath, rational approximants by mpmath's Padé and scipy's
bilinear transform, impulse responses by scipy's lfilter: none of them shares a line with the code under test.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from pathlib import Path

import mpmath
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.signal import bilinear_zpk, lfilter

from nodes.kernels import fir, push, sections
from nodes.laws import CompiledLaw
from nodes.laws.derivatives import derivative_kinds, realise
from nodes.laws.derivatives.bdf import lubich
from nodes.laws.derivatives.cfe import whole_order
from nodes.laws.derivatives.exponentials import exponentials
from nodes.laws.derivatives.gl import coefficients
from nodes.laws.derivatives.log_binned import bins
from nodes.laws.parse import compile_law, parse_law
from nodes.stability.closed_loop import pole_radius, state_matrix
from sim.chart.derivative_errors import analyse, apply, best_delay, largest_pole, lengths_taken, response
from sim.device.model import DeviceModel
from sim.scene.loop import Scene, Surface, run

T = 0.002
EPS = 2.0**-52
KINDS = sorted(derivative_kinds())
BDF = ("bdf2", "bdf3", "bdf4", "bdf5", "bdf6")
RECURSIVE = ("tustin_cfe", "al_alaoui_cfe", "oustaloup_tustin", "oustaloup_matched", "least_squares")
# What one tick of the loop does with a length each realisation takes at any order.
LENGTH = {**dict.fromkeys(KINDS, 64), **dict.fromkeys(RECURSIVE, 11)}
CASES = [
    pytest.param(kind, order, id=f"{kind}-{order}")
    for kind in KINDS
    for order in (0.1, 0.5, 0.9, 1.0, 1.5, 2.0, 2.5, 3.47)
    if kind != "log_binned" or order <= 2.0
]


def orders_of(kind: str) -> st.SearchStrategy[float]:
    """Orders that a realisation takes."""
    return st.floats(min_value=0.01, max_value=2.0 if kind == "log_binned" else 3.99)


def loop(law: CompiledLaw, samples: list[float]) -> list[float]:
    """Render as the coupling does: its own kernels over its own ring."""
    length = max(len(law.taps), 2)
    history, head = [0.0] * (2 * length), 0
    flat = [c for section in law.sections for c in section]
    state = [0.0] * (2 * len(law.sections))
    output = []
    for sample in samples:
        head = push(history, head, length, sample)
        force = fir(law.taps, history, head)
        if flat:
            force += sections(flat, state, history[head], history[head + 1])
        output.append(force)
    return output


def size(law: CompiledLaw) -> float:
    """Sum of the magnitudes a unit deflection is multiplied with: the scale of rounding."""
    return math.fsum(map(abs, law.taps)) + sum(
        float(np.sum(np.abs(lfilter([b0, b1], [1.0, a1, a2], np.eye(1, 4000)[0])))) for b0, b1, a1, a2 in law.sections
    )


def ticks(count: int, step: float) -> NDArray[np.float64]:
    """Give the sampling instants."""
    return np.arange(count, dtype=np.float64) * np.float64(step)


def at(law: CompiledLaw, fraction: float) -> complex:
    """Response at a fraction of Nyquist."""
    return complex(response(law, np.array([math.pi * fraction]))[0])


def test_all_families_of_the_field_are_registered() -> None:
    families = {"gl", "gl_leak_corrected", *BDF, "l1", *RECURSIVE, "exponentials", "log_binned"}
    assert families <= set(KINDS)


@pytest.mark.parametrize(("kind", "order"), CASES)
def test_loop_renders_what_taps_and_sections_say(kind: str, order: float) -> None:
    law = realise(kind, order, LENGTH[kind], T)
    samples = np.random.default_rng(1).normal(size=300)
    # Rounding only: each of at most 300 terms per sum is off by half an ulp of the largest product.
    tolerance = 300 * EPS * size(law) * float(np.max(np.abs(samples)))
    assert np.max(np.abs(apply(law, samples) - loop(law, samples.tolist()))) <= tolerance
    assert largest_pole(law) < 1.0
    assert law.stable_sections()


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=15, deadline=None)
@given(data=st.data(), left=st.floats(-2.0, 2.0), right=st.floats(-2.0, 2.0), seed=st.integers(0, 99))
def test_linear(kind: str, data: st.DataObject, left: float, right: float, seed: int) -> None:
    law = realise(kind, data.draw(orders_of(kind)), LENGTH[kind], T)
    first, second = np.random.default_rng(seed).uniform(-1.0, 1.0, size=(2, 40))
    both = loop(law, (left * first + right * second).tolist())
    parts = left * np.array(loop(law, first.tolist())) + right * np.array(loop(law, second.tolist()))
    # Two evaluations, each rounded 40 times over terms of at most size * (|left| + |right|).
    assert np.max(np.abs(parts - both)) <= 100 * EPS * size(law) * (abs(left) + abs(right) + EPS)


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=15, deadline=None)
@given(data=st.data(), period=st.floats(1e-4, 0.1))
def test_gain_goes_as_period_to_the_minus_order(kind: str, data: st.DataObject, period: float) -> None:
    order = data.draw(orders_of(kind))
    law, unit = realise(kind, order, LENGTH[kind], period), realise(kind, order, LENGTH[kind], 1.0)
    scale = period**-order
    # The same numbers up to the rounding of T^−α, relative to the largest of them.
    largest = scale * max([*map(abs, unit.taps), *(abs(b) for s in unit.sections for b in s[:2])])
    assert np.max(np.abs(np.array(law.taps) - scale * np.array(unit.taps))) <= 64 * EPS * largest
    for (b0, b1, a1, a2), (u0, u1, c1, c2) in zip(law.sections, unit.sections, strict=True):
        assert abs(b0 - scale * u0) <= 64 * EPS * largest
        assert abs(b1 - scale * u1) <= 64 * EPS * largest
        # Oustaloup's poles are mapped through a product with T, which may round them by an ulp.
        assert (a1, a2) == pytest.approx((c1, c2), abs=4 * EPS)


@settings(max_examples=150, deadline=None)
@given(
    kind=st.sampled_from(KINDS),
    order=st.floats(min_value=0.0, max_value=4.0, exclude_min=True, exclude_max=True),
    taps=st.integers(2, 120),
    period=st.floats(1e-4, 0.05),
)
@example(kind="tustin_cfe", order=2.0 - 2 * EPS, taps=4, period=0.03125)
@example(kind="al_alaoui_cfe", order=2.0 - 2 * EPS, taps=3, period=0.03125)
def test_either_runs_or_says_why_not(kind: str, order: float, taps: int, period: float) -> None:
    refusal, law = "", None
    try:
        law = realise(kind, order, taps, period)
    except ValueError as error:
        refusal = str(error)
    if law is None:
        assert refusal.startswith((f"taps = {taps}: ", f"order = {order:g}: log"))
        assert kind != "gl"
    else:
        assert law.finite
        assert law.stable_sections()


@pytest.mark.parametrize("whole", [1, 2, 3])
@pytest.mark.parametrize("kind", KINDS)
def test_whole_orders_differentiate_powers_exactly(kind: str, whole: int) -> None:
    law = realise(kind, float(whole), LENGTH[kind], 0.5)
    time = ticks(80, 0.5)
    output = apply(law, time**whole)
    # D^k t^k = k! once the taps are full, for a difference of any order of accuracy; rounding grows with t^k at the end.
    assert output[-10:] == pytest.approx(math.factorial(whole), abs=40 * EPS * size(law) * time[-1] ** whole)


@pytest.mark.parametrize(
    ("kind", "near"),
    [
        pytest.param(kind, near, id=f"{kind}-{near}")
        for kind in KINDS
        for near in (1.0 - 1e-9, 1.0 + 1e-9, 2.0 - 1e-9, 2.0 + 1e-9)
        # Refused above 2; and x[k] − x[k−n] for β → 0, see test_l1_just_above_a_whole_order.
        if not ((kind == "log_binned" and near > 2.0) or (kind == "l1" and near % 1.0 < 0.5))
    ],
)
def test_order_goes_over_into_whole_orders(kind: str, near: float) -> None:
    law = realise(kind, near, LENGTH[kind], T)
    angle = 0.05 * math.pi
    wanted = (1j * angle / T) ** round(near)
    # A lag of at most one tick per derivative (half a tick in truth) and, for memories of ~60 ticks, little else.
    assert abs(at(law, 0.05) / wanted - 1.0) <= round(near) * angle


def test_l1_just_above_a_whole_order_subtracts_the_oldest_sample() -> None:
    taps = realise("l1", 1.0 + 1e-12, 10, 1.0).taps
    # (1 − w)(1 − w⁸): one difference, and eight intervals. b_m = (m+1)^{1−β} − m^{1−β} → 1 but for β ln(m).
    assert taps == pytest.approx([1.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 1.0], abs=1e-11)


# --- time domain: Riemann-Liouville, lower terminal 0 ---------------------------------------------------------------


def power(order: float, time: float) -> float:
    return float(mpmath.gamma(3) * mpmath.rgamma(3 - order) * math.pow(time, 2.0 - order))


def exponential(order: float, time: float) -> float:
    return math.pow(time, -order) * float(mittag_leffler(1.0, 1.0 - order, -2.0 * time))


def sine(order: float, time: float) -> float:
    return 8.0 * math.pow(time, 1.0 - order) * float(mittag_leffler(2.0, 2.0 - order, -64.0 * time * time))


def cosine(order: float, time: float) -> float:
    return math.pow(time, -order) * float(mittag_leffler(2.0, 1.0 - order, -64.0 * time * time))


def mittag_leffler(a: float, b: float, argument: float) -> mpmath.mpf:
    """E_{a,b} from its series, with digits enough for the cancellation."""
    with mpmath.workdps(60):
        return mpmath.nsum(
            lambda j: mpmath.mpf(argument) ** int(j) * mpmath.rgamma(mpmath.mpf(a) * j + mpmath.mpf(b)),
            [0, mpmath.inf],
            method="direct",
        )


SIGNALS: dict[str, tuple[Callable[[NDArray[np.float64]], NDArray[np.float64]], Callable[[float, float], float], float]]
SIGNALS = {
    "power": (lambda t: t * t, power, 0.0),
    "exponential": (lambda t: np.exp(-2.0 * t), exponential, 1.0),
    "sine": (lambda t: np.sin(8.0 * t), sine, 0.0),
    "cosine": (lambda t: np.cos(8.0 * t), cosine, 1.0),
}


def lag(kind: str, order: float) -> float:
    """Delay of a realisation at low frequency [ticks], from the phase of its symbol."""
    whole = math.floor(order)
    fraction = order - whole
    if kind in BDF:
        return 0.0
    if kind == "l1":
        return 0.5 * whole
    if kind == "tustin_cfe":
        return 0.5 * whole
    if kind == "al_alaoui_cfe":
        # (1−w)/(1+w/7): half a tick, less (1/7)/(1+1/7) = an eighth.
        return 0.5 * whole + 0.375 * fraction
    return 0.5 * order


TICKS = 500
# Memory beyond the whole run: 600 taps, or recursive degrees whose memory (n² ticks or so) is that long.
LONG = {
    **dict.fromkeys(KINDS, 600),
    **dict.fromkeys(("tustin_cfe", "al_alaoui_cfe"), 61),
    **dict.fromkeys(("oustaloup_tustin", "oustaloup_matched"), 31),
    "least_squares": 15,
    "exponentials": 2000,
}
# How well each approximation claims to follow its own symbol, relative to what it renders. Exact convolutions: 0.
APPROXIMATION = {
    **dict.fromkeys(KINDS, 0.0),
    "exponentials": 2e-3,  # trapezium rule with h = 0.9 over one decaying exponential per 1/e
    "log_binned": 4e-3,  # bins an eighth of their age wide: (1/8)²/12·(1+β)(2+β) at most
    "least_squares": 1e-2,  # ripple of the fit between its poles
    "oustaloup_tustin": 2e-2,  # ripple and band edge, five decades below Nyquist
    "oustaloup_matched": 2e-2,
}


@pytest.mark.parametrize(
    ("kind", "signal", "order"),
    [
        pytest.param(kind, signal, order, id=f"{kind}-{signal}-{order}")
        for kind in LONG
        for signal in SIGNALS
        for order in (0.3, 0.5, 0.8, 1.5, 2.5)
        # Refused above 2; and ringing after any corner, see test_tustin_rings_after_a_corner.
        if not (kind == "log_binned" and order > 2.0)
        and not (kind == "tustin_cfe" and (signal != "power" or order > 2.0))
    ],
)
def test_follows_the_fractional_derivative(kind: str, signal: str, order: float) -> None:
    function, oracle, jump = SIGNALS[signal]
    step = 1.0 / TICKS
    output = apply(realise(kind, order, LONG[kind], step), function(ticks(TICKS + 1, step)))[-1]
    exact, slope, curvature = (oracle(order + i, 1.0) for i in range(3))
    # First-order terms are known: the realisation's lag, and the jump at 0, which samples see half a tick early.
    predicted = exact - lag(kind, order) * step * slope + 0.5 * step * jump / math.gamma(-order)
    # Second order: a symbol's next term is at most α/3 (BDF2) or (α/2)²/2 + α/24 (GL) times T² D^{α+2}.
    tolerance = step**2 * (abs(curvature) * (order / 3.0 + order**2 / 8.0) + 1.0)
    if kind == "l1":
        # L1's own error, |ζ(β−1)|/Γ(2−β) <= 0.57 times T^{2−β} D^{k+2}; and the jump of the (k+1)st derivative at 0.
        whole = math.floor(order)
        tolerance += 0.6 * step ** (2.0 - order + whole) * max(8.0 ** (2 + whole), 2.0)
    scale = abs(exact) + jump / abs(math.gamma(1.0 - order)) + 1.0
    assert output == pytest.approx(predicted, abs=tolerance + APPROXIMATION[kind] * scale)


@pytest.mark.parametrize("order", [0.2, 0.5, 1.2, 1.5, 1.8])
@pytest.mark.parametrize("count", [100, 1000])
def test_full_memory_gl_on_a_parabola(order: float, count: int) -> None:
    step = 1.0 / count
    output = apply(realise("gl", order, count + 1, step), ticks(count + 1, step) ** 2)[-1]
    relative = output / power(order, 1.0) - 1.0
    # Leading order (THEORY.md §7); the next term is T² times a polynomial in α that stays below 1 for α < 2.
    assert relative == pytest.approx(-0.5 * order * (2.0 - order) * step, abs=step**2)


def test_tustin_rings_after_a_corner() -> None:
    step = 1.0 / TICKS
    output = apply(realise("tustin_cfe", 0.5, 61, step), np.ones(TICKS + 1))
    decayed = float(1.0 / mpmath.gamma(0.5))
    # The pole nearest −1 dies out over n² ticks: half a thousand ticks after the step the sign still alternates.
    assert abs(output[-1] - output[-2]) > 0.5 * decayed
    assert abs(0.5 * (output[-1] + output[-2]) - decayed) < 0.01 * decayed


# --- frequency domain ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("order", [0.3, 0.8, 1.5, 2.7, 3.47])
def test_gl_has_the_delay_of_half_alpha(order: float) -> None:
    angles = np.geomspace(0.05, 2.5, 50)
    relative = response(realise("gl", order, 4000, 1.0), angles) / (1j * angles) ** order
    # Exact for infinite memory; the cut adds |c_n|/sin(θ/2) at most, 4000^−1.3/0.025 = 1e−3 of θ^α for α = 0.3.
    assert best_delay(relative, angles) == pytest.approx(0.5 * order, abs=0.01)


@pytest.mark.parametrize("fraction", [0.02, 0.2, 0.7])
@pytest.mark.parametrize("order", [0.3, 0.9, 1.5, 3.47])
@pytest.mark.parametrize("degree", [2, 3, 4, 5, 6])
def test_bdf_is_the_power_of_its_polynomial(degree: int, order: float, fraction: float) -> None:
    law = lubich(order, 3000, 1.0, degree)
    w = cmath.exp(-1j * math.pi * fraction)
    symbol = sum((1.0 - w) ** j / j for j in range(1, degree + 1)) ** order
    # The tail of a monotone series times e^{−jmθ} is at most its first term over sin(θ/2).
    cut = abs(law.taps[-1]) / math.sin(0.5 * math.pi * fraction)
    assert abs(at(law, fraction) - symbol) <= cut + 3000 * EPS * size(law)


@pytest.mark.parametrize("degree", [1, 4, 9])
@pytest.mark.parametrize("order", [0.3, 0.9, 1.5, 3.47])
@pytest.mark.parametrize(("kind", "left"), [("tustin_cfe", 1.0), ("al_alaoui_cfe", 1.0 / 7.0)])
def test_continued_fraction_is_the_pade_approximant(kind: str, left: float, order: float, degree: int) -> None:
    whole, fraction = math.floor(order), order - math.floor(order)
    law = realise(kind, order, degree + 1, T)
    with mpmath.workdps(60):
        a, beta = mpmath.mpf(left), mpmath.mpf(fraction)
        binomials = [
            ((-1) ** m * mpmath.binomial(beta, m), a**m * mpmath.binomial(-beta, m)) for m in range(2 * degree + 1)
        ]
        series = [sum(binomials[j][0] * binomials[m - j][1] for j in range(m + 1)) for m in range(2 * degree + 1)]
        top, bottom = mpmath.pade(series, degree, degree)
        for angle in (0.003, 0.1, 0.5, 1.0):
            w = mpmath.expj(-mpmath.pi * angle)
            exact = sum(c * w**m for m, c in enumerate(top)) / sum(c * w**m for m, c in enumerate(bottom))
            exact *= ((1 + a) / T) ** beta * ((1 - w) / T) ** whole
            # (1 − w)^k cancels k digits' worth of the sections' rounding at low frequency.
            rounding = 1e3 * EPS * size(law)
            assert abs(at(law, angle) - complex(exact)) <= rounding + 1e-9 * abs(complex(exact))


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
        zeros, poles, _ = bilinear_zpk(zeros, poles, high**fraction, 1.0 / T)
    else:
        zeros, poles = np.exp(zeros * T), np.exp(poles * T)

    def exact(angle: float) -> complex:
        z = cmath.exp(1j * angle)
        return complex(np.prod((z - zeros) / (z - poles))) * ((1.0 - 1.0 / z) / T) ** whole

    middle = math.sqrt(low * high) * T
    gain = (middle / T) ** fraction / abs(exact(middle) / ((1.0 - cmath.exp(-1j * middle)) / T) ** whole)
    for angle in (0.002, 0.05, 0.5, 3.0):
        # Partial fractions and product differ by rounding, of the size of the largest gain.
        assert abs(at(law, angle / math.pi) - gain * exact(angle)) <= 1e3 * EPS * size(law)
    # The band reaches from Nyquist down half a decade per pair: in its middle the slope is right within its ripple.
    assert abs(at(law, middle / math.pi)) == pytest.approx((middle / T) ** order, rel=1e-3)


@pytest.mark.parametrize("order", [0.2, 0.5, 0.9])
@pytest.mark.parametrize("memory", [8, 100, 2000])
def test_exponentials_keep_the_weights_of_gl(order: float, memory: int) -> None:
    law = exponentials(order, memory, 1.0)
    impulse = np.eye(1, memory)[0]
    weights = np.cumsum(apply(law, impulse))
    exact = [float(mpmath.rf(1 - order, m) / mpmath.factorial(m)) for m in range(memory)]
    # The first four are kept; h = 0.9 and all rates below 0.05/N on one pole leave 1 % of the weight itself at age N.
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
        # At the minimum the residual is orthogonal to all that was fitted, up to the rounding of cond ≈ 300 squared.
        assert slope <= 1e-8 * float(np.linalg.norm(column))


# --- leaks and start-up ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("order", [0.1, 0.5, 0.9, 1.3, 1.9, 2.5, 3.47])
@pytest.mark.parametrize("taps", [4, 50, 1000])
def test_gl_leaks_as_the_binomial_sum(order: float, taps: int) -> None:
    leak = realise("gl", order, taps, T).h1 * T**order
    exact = float(mpmath.gammaprod([taps - order], [1 - order, taps]))
    assert leak == pytest.approx(exact, abs=taps * EPS * 2.0**order)
    if taps == 1000:
        # (nT)^−α/Γ(1−α), in units of T^−α, with corrections of order α(α+1)/n.
        assert exact == pytest.approx(
            float((taps - 1) ** -order * mpmath.rgamma(1 - order)), rel=order * (order + 1.0) / 1000
        )
        assert (exact > 0.0) == (order < 1.0 or 2.0 < order < 3.0)


@pytest.mark.parametrize("kind", ["gl_leak_corrected", "l1", "exponentials", "least_squares"])
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
        return analyse(kind, order, taps, T).error()

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


# --- what breaks, and how loudly --------------------------------------------------------------------------------------


def fraction_response(zeros: list[complex], poles: list[complex], z: complex) -> complex:
    return math.prod((z - a for a in zeros), start=1.0 + 0j) / math.prod((z - p for p in poles), start=1.0 + 0j)


@pytest.mark.parametrize("order", [1.2, 1.5, 1.9, 2.5])
@pytest.mark.parametrize("degree", [1, 3, 9])
def test_tustin_expanded_for_the_whole_order_is_unstable(order: float, degree: int) -> None:
    _, poles = whole_order(order, degree, 1.0)
    assert max(map(abs, poles)) > 1.0
    assert largest_pole(realise("tustin_cfe", order, degree + 1, T)) < 1.0
    # For the fraction alone the same expansion is stable, and the same as the Gauss–Jacobi form.
    zeros, poles = whole_order(order - math.floor(order), degree, 1.0)
    assert max(map(abs, poles)) < 1.0
    z = cmath.exp(0.3j)
    expanded = fraction_response(zeros, poles, z) * (2.0 / T) ** (order - math.floor(order))
    assert at(realise("tustin_cfe", order - math.floor(order), degree + 1, T), 0.3 / math.pi) == pytest.approx(
        expanded, rel=1e-9
    )


@pytest.mark.parametrize("order", [1.2, 1.5, 1.8])
def test_al_alaoui_expanded_for_the_whole_order_is_stable_but_wrong_at_low_frequency(order: float) -> None:
    degree, angle = 5, 0.002 * math.pi
    zeros, poles = whole_order(order, degree, 1.0 / 7.0)
    assert max(map(abs, poles)) < 1.0
    z = cmath.exp(1j * angle)
    wanted = (1j * angle) ** order
    whole = abs(fraction_response(zeros, poles, z) * (8.0 / 7.0) ** order / wanted - 1.0)
    split = abs(at(realise("al_alaoui_cfe", order, degree + 1, 1.0), 0.002) / wanted - 1.0)
    assert whole > 1.0
    assert split < 0.6 * whole
    assert abs(fraction_response(zeros, poles, 1.0)) > 1e-4
    assert abs(realise("al_alaoui_cfe", order, degree + 1, 1.0).h1) < 1e-12


@pytest.mark.parametrize("order", [0.5, 1.5])
def test_accuracy_near_nyquist_is_paid_with_gain_there(order: float) -> None:
    figures = [analyse(kind, order, 2000, T) for kind in ("gl", *BDF)]
    error = [abs(at(realise(kind, order, 2000, T), 0.3) / (0.3j * math.pi / T) ** order - 1.0) for kind in ("gl", *BDF)]
    assert error == sorted(error, reverse=True)
    for degree, figure in zip(range(1, 7), figures, strict=True):
        exact = (sum(2.0**j / j for j in range(1, degree + 1)) / 2.0) ** order
        # Cut after 2000 taps: |c_n|/2 more or less.
        assert figure.nyquist == pytest.approx(exact, rel=1e-3)


def test_bdf7_would_grow_without_bound() -> None:
    with pytest.raises(ValueError, match=r"degree = 7: .* 2 to 6"):
        lubich(0.5, 100, T, 7)
    polynomial = np.poly1d([0.0])
    for j in range(1, 8):
        polynomial = polynomial + np.poly1d([-1.0, 1.0]) ** j / j
    roots = np.abs(polynomial.roots)
    # A zero inside the unit disc (besides w = 1 on it): the power series of any fractional power grows.
    assert np.min(roots) < 1.0 - 1e-6


REFUSED = [
    # kind, order, last taps refused, first taps taken
    ("gl_leak_corrected", 0.5, 1, 2),
    ("gl_leak_corrected", 1.5, 2, 3),
    ("gl_leak_corrected", 3.47, 4, 5),
    ("bdf2", 0.5, 2, 3),
    ("bdf2", 1.5, 4, 5),
    ("bdf6", 3.47, 24, 25),
    ("l1", 1.5, 2, 3),
    ("l1", 3.47, 4, 5),
    ("tustin_cfe", 0.5, 202, 201),
    ("al_alaoui_cfe", 0.5, 202, 201),
    ("oustaloup_tustin", 0.5, 2, 3),
    ("oustaloup_matched", 0.5, 202, 201),
    ("exponentials", 0.5, 7, 8),
    ("exponentials", 0.5, 1_000_001, 1_000_000),
    ("log_binned", 0.5, 16, 17),
    ("log_binned", 1.5, 17, 18),
    ("least_squares", 0.5, 3, 4),
    ("least_squares", 0.5, 16, 15),
]


@pytest.mark.parametrize(("kind", "order", "refused", "taken"), REFUSED)
def test_first_bad_length_is_refused_by_name(kind: str, order: float, refused: int, taken: int) -> None:
    with pytest.raises(ValueError, match=rf"^taps = {refused}: "):
        realise(kind, order, refused, T)
    assert realise(kind, order, taken, T).finite


def test_log_bins_refuse_orders_above_two() -> None:
    with pytest.raises(ValueError, match=r"^order = 2.001: .* up to 2"):
        realise("log_binned", 2.001, 100, T)
    assert realise("log_binned", 1.999, 100, T).finite
    # Why: a jump 512 ticks ago lies on the edge of a bin, and two differences make a click of it.
    binned = np.array(realise("log_binned", 0.5, 1000, 1.0).taps)
    exact = np.array(realise("gl", 0.5, 1000, 1.0).taps)
    clicks = np.abs(np.diff(binned, 2) - np.diff(exact, 2))
    assert clicks[510:513].max() > 100.0 * clicks[520:540].max()


@pytest.mark.parametrize("order", [0.0, -0.5, 4.0, math.nan, math.inf])
@pytest.mark.parametrize("kind", ["gl", "tustin_cfe"])
def test_orders_outside_are_refused(kind: str, order: float) -> None:
    with pytest.raises(ValueError, match=r"^order = .*\(0, 4\)"):
        realise(kind, order, 10, T)


@pytest.mark.parametrize("period", [0.0, -0.002, math.nan, math.inf])
def test_periods_are_refused(period: float) -> None:
    with pytest.raises(ValueError, match=r"^period = "):
        realise("gl", 0.5, 10, period)


@pytest.mark.parametrize("kind", KINDS)
def test_overflow_is_refused(kind: str) -> None:
    # T^−α beyond 1.8e308.
    with pytest.raises(ValueError, match=r"^period = 1e-200 s at order = 1.9: .*overflow"):
        realise(kind, 1.9, LENGTH[kind], 1e-200)


def test_unknown_realisation_names_the_known_ones() -> None:
    with pytest.raises(ValueError, match=r"derivative = 'crone' is not .*exponentials, gl, "):
        realise("crone", 0.5, 10, T)


def test_recursion_does_not_overflow_where_the_gamma_ratio_does() -> None:
    series = coefficients(0.5, 2001)
    with mpmath.workdps(40):
        exact = (-1) ** 2000 * mpmath.binomial(mpmath.mpf(0.5), 2000)
    assert series[2000] == pytest.approx(float(exact), rel=2000 * EPS)
    with pytest.raises(OverflowError):
        math.gamma(172.0)


def test_lengths_taken_are_found_by_asking() -> None:
    assert lengths_taken("l1", 3.47, T) == (5, 2000)
    assert lengths_taken("tustin_cfe", 0.5, T) == (2, 201)
    assert lengths_taken("least_squares", 0.5, T) == (4, 15)
    assert lengths_taken("log_binned", 2.5, T) is None


@pytest.mark.parametrize("order", [0.5, 1.5])
@pytest.mark.parametrize("kind", KINDS)
def test_every_realisation_works_in_the_loop_as_a_law(kind: str, order: float) -> None:
    law = parse_law(
        {
            "kind": "pd_alpha",
            "stiffness": 300.0,
            "damping": 1.0,
            "order": order,
            "taps": LENGTH[kind],
            "gains": "paper",
            "derivative": kind,
        }
    )
    compiled = compile_law(law, T)
    # b = 3 N s/m keeps a 300 N/m spring stable at no delay by a wide margin; what is tested is that the loop's own
    # kernels and the state matrix agree about the law.
    assert pole_radius(compiled, T, 0.1, 3.0) < 1.0
    device = DeviceModel(mass=0.1, damping=3.0, position=0.005)
    scene = Scene(device=device, surface=Surface("anchor"), period=T, raw=False, clamp=False)
    trace = run(scene, compiled, 600, interpreted=True)
    state = state_matrix(compiled, T, 0.1, 3.0)
    x = np.zeros(len(state))
    x[0] = 0.005
    for k in range(600):
        # Two orders of the same sums, 600 times over, relative to the 5 mm that it starts with.
        assert trace.position[k] == pytest.approx(x[0], abs=1e-9 * 0.005)
        x = state @ x


def test_a_realisation_from_another_package_works_by_being_installed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "elsewhere.py").write_text(
        "from nodes.laws import CompiledLaw\n\n"
        "def forward(order, taps, period):\n"
        "    return CompiledLaw((1.0 / period, -1.0 / period), ((0.0, 1.0, -order, 0.0),))\n"
    )
    info = tmp_path / "elsewhere-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: elsewhere\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[haptic.derivatives]\nforward_of_elsewhere = elsewhere:forward\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    assert "forward_of_elsewhere" in derivative_kinds()
    assert realise("forward_of_elsewhere", 0.5, 2, 0.5).taps == (2.0, -2.0)
    # What it returns is checked as ours is: a pole at 1.5 is refused.
    with pytest.raises(ValueError, match=r"'forward_of_elsewhere' has a pole on or outside the unit circle"):
        realise("forward_of_elsewhere", 1.5, 2, 0.5)
