"""Realisations of D^α in time: Mittag-Leffler functions and Gamma ratios by mpmath."""

from __future__ import annotations

import math
from collections.abc import Callable

import mpmath
import numpy as np
import pytest
from numpy.typing import NDArray

from nodes.laws.derivatives import realise
from tests.support.realisations import BDF, KINDS, apply, ticks

# --- time domain: Riemann-Liouville, lower terminal 0
# ---------------------------------------------------------------


def power(order: float, time: float) -> float:
    return float(
        mpmath.gamma(3) * mpmath.rgamma(3 - order) * math.pow(time, 2.0 - order)
    )


def exponential(order: float, time: float) -> float:
    return math.pow(time, -order) * float(mittag_leffler(1.0, 1.0 - order, -2.0 * time))


def sine(order: float, time: float) -> float:
    return (
        8.0
        * math.pow(time, 1.0 - order)
        * float(mittag_leffler(2.0, 2.0 - order, -64.0 * time * time))
    )


def cosine(order: float, time: float) -> float:
    return math.pow(time, -order) * float(
        mittag_leffler(2.0, 1.0 - order, -64.0 * time * time)
    )


def mittag_leffler(a: float, b: float, argument: float) -> mpmath.mpf:
    """Return E_{a,b} from its series, with enough digits for the cancellation."""
    with mpmath.workdps(60):
        return mpmath.nsum(
            lambda j: (
                mpmath.mpf(argument) ** int(j)
                * mpmath.rgamma(mpmath.mpf(a) * j + mpmath.mpf(b))
            ),
            [0, mpmath.inf],
            method="direct",
        )


SIGNALS: dict[
    str,
    tuple[
        Callable[[NDArray[np.float64]], NDArray[np.float64]],
        Callable[[float, float], float],
        float,
    ],
]
SIGNALS = {
    "power": (lambda t: t * t, power, 0.0),
    "exponential": (lambda t: np.exp(-2.0 * t), exponential, 1.0),
    "sine": (lambda t: np.sin(8.0 * t), sine, 0.0),
    "cosine": (lambda t: np.cos(8.0 * t), cosine, 1.0),
}


def lag(kind: str, order: float) -> float:
    """Return the low-frequency delay of a realisation [ticks], from the phase of its symbol."""
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
# Memory beyond the whole run: 600 taps, or recursive degrees whose memory (n² ticks or so) is that
# long.
LONG = {
    **dict.fromkeys(KINDS, 600),
    **dict.fromkeys(("tustin_cfe", "al_alaoui_cfe"), 61),
    **dict.fromkeys(("oustaloup_tustin", "oustaloup_matched"), 31),
    "least_squares": 15,
    "exponentials": 2000,
}
# How well each approximation claims to follow its own symbol, relative to what it renders. Exact
# convolutions: 0.
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
def test_follows_the_fractional_derivative(
    kind: str, signal: str, order: float
) -> None:
    function, oracle, jump = SIGNALS[signal]
    step = 1.0 / TICKS
    output = apply(
        realise(kind, order, LONG[kind], step), function(ticks(TICKS + 1, step))
    )[-1]
    exact, slope, curvature = (oracle(order + i, 1.0) for i in range(3))
    # First-order terms are known: the realisation's lag, and the jump at 0, which samples see half
    # a tick early.
    predicted = (
        exact - lag(kind, order) * step * slope + 0.5 * step * jump / math.gamma(-order)
    )
    # Second order: a symbol's next term is at most α/3 (BDF2) or (α/2)²/2 + α/24 (GL) times T²
    # D^{α+2}.
    tolerance = step**2 * (abs(curvature) * (order / 3.0 + order**2 / 8.0) + 1.0)
    if kind == "l1":
        # L1's own error, |ζ(β−1)|/Γ(2−β) <= 0.57 times T^{2−β} D^{k+2}; and the jump of the (k+1)st
        # derivative at 0.
        whole = math.floor(order)
        tolerance += 0.6 * step ** (2.0 - order + whole) * max(8.0 ** (2 + whole), 2.0)
    scale = abs(exact) + jump / abs(math.gamma(1.0 - order)) + 1.0
    assert output == pytest.approx(
        predicted, abs=tolerance + APPROXIMATION[kind] * scale
    )


@pytest.mark.parametrize("order", [0.2, 0.5, 1.2, 1.5, 1.8])
@pytest.mark.parametrize("count", [100, 1000])
def test_full_memory_gl_on_a_parabola(order: float, count: int) -> None:
    step = 1.0 / count
    output = apply(realise("gl", order, count + 1, step), ticks(count + 1, step) ** 2)[
        -1
    ]
    relative = output / power(order, 1.0) - 1.0
    # Leading order (THEORY.md §7); the next term is T² times a polynomial in α that stays below 1
    # for α < 2.
    assert relative == pytest.approx(-0.5 * order * (2.0 - order) * step, abs=step**2)


def test_tustin_rings_after_a_corner() -> None:
    step = 1.0 / TICKS
    output = apply(realise("tustin_cfe", 0.5, 61, step), np.ones(TICKS + 1))
    decayed = float(1.0 / mpmath.gamma(0.5))
    # The pole nearest −1 dies out over n² ticks: half a thousand ticks after the step the sign
    # still alternates.
    assert abs(output[-1] - output[-2]) > 0.5 * decayed
    assert abs(0.5 * (output[-1] + output[-2]) - decayed) < 0.01 * decayed
