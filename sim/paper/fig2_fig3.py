"""The seed's figures 2 and 3: f(ω) of Grünwald–Letnikov terms and of their optimised sum, in the seed's normalisation.

Everything is in units of ω_N and of a term with f(ω_N) = 1, which is the same as measuring time so that T = 2 (theory.md §2).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nodes.laws.presets import PRESETS
from sim.paper.claims import Claim, verdict
from sim.paper.descent import damping_curve

Vector = NDArray[np.float64]

ORDERS = (0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5)
"""Orders drawn in figure 2."""


def term_curve(theta: Vector, order: float) -> Vector:
    """Give f of one term with unlimited memory, normalised: (sin(θ/2))^{α−1} cos((α+1)(π−θ)/2).

    Parameters
    ----------
    theta : ndarray
        ωT, 0 < ωT ≤ π.
    order : float
        α.

    Returns
    -------
    ndarray, shape of theta
        f, 1 at ω_N.
    """
    shape = np.sin(theta / 2.0) ** (order - 1.0) * np.cos(0.5 * (order + 1.0) * (math.pi - theta))
    return np.asarray(shape, dtype=np.float64)


@dataclass(frozen=True)
class Term:
    """Figure 2, one curve.

    Attributes
    ----------
    order : float
        α.
    curve : ndarray
        f of unlimited memory at the frequencies of the figure.
    short : ndarray
        f with the taps of the figure.
    zero : float
        Where f first becomes positive for good, ω/ω_N.
    """

    order: float
    curve: Vector
    short: Vector
    zero: float


def figure_2(taps: int, points: int = 400) -> tuple[Vector, list[Term]]:
    """Compute f(ω) of single terms.

    Parameters
    ----------
    taps : int
        n + 1 of the short filters drawn beside unlimited memory.
    points : int
        Frequencies.

    Returns
    -------
    tuple of ndarray and list of Term
        ωT of the points, and the curves.
    """
    theta = np.pi * np.arange(1, points + 1) / points
    terms = []
    for order in ORDERS:
        zero = _last_zero(lambda t, a=order: float(term_curve(np.array([t]), a)[0]))
        short = damping_curve(theta, np.ones(1), np.array([order]), taps)
        terms.append(Term(order, term_curve(theta, order), short, zero / math.pi))
    return theta, terms


def _last_zero(f: Any) -> float:
    """Bisect for the highest sign change below π of a function that is positive at π."""
    from scipy.optimize import brentq

    high = math.pi
    step = math.pi / 2000.0
    while high > step and f(high - step) > 0.0:
        high -= step
    return float(brentq(f, max(high - step, 1e-9), high, xtol=1e-14))


def claims_2(taps: int) -> list[Claim]:
    """Check what theory.md states about figure 2.

    Parameters
    ----------
    taps : int
        n + 1 of the short filters.

    Returns
    -------
    list of Claim
        Normalisation, zero, and what a short memory leaves of them.
    """
    theta, terms = figure_2(taps)
    nyquist = max(abs(term.curve[-1] - 1.0) for term in terms)
    worst_zero = max(abs(term.zero - term.order / (term.order + 1.0)) for term in terms)
    # 4096 taps against the closed form, away from ω = 0 where no finite memory reaches.
    inside = theta >= 0.05 * math.pi
    long = max(
        float(np.abs(damping_curve(theta, np.ones(1), np.array([t.order]), 4096) - t.curve)[inside].max())
        for t in terms
        if t.order >= 1.0
    )
    pd = next(term for term in terms if term.order == 1.0)
    cosine = float(np.abs(pd.short + np.cos(theta)).max())
    short = {term.order: float(term.short[-1]) for term in terms}
    lowest, highest = min(short.values()), max(short.values())
    leaks = {term.order: _leak(term.order, taps) for term in terms}
    worst_leak = max(leaks, key=lambda a: abs(leaks[a]))
    return [
        Claim(
            "theory.md §2; seed, fig. 2",
            "per term, B_α is chosen such that f(ω_N) = 1",
            verdict(nyquist < 1e-12 and highest - lowest < 1e-12, nyquist < 1e-12),
            f"unlimited memory: |f(ω_N) − 1| ≤ {nyquist:.0e}; only if memory is long: with {taps} taps f(ω_N) is "
            f"{lowest:.3f} … {highest:.3f}",
        ),
        Claim(
            "theory.md §2",
            "f of a term has its zero at ω/ω_N = α/(α+1), unlimited memory",
            verdict(worst_zero < 1e-9),
            f"largest distance over α = {ORDERS[0]} … {ORDERS[-1]}: {worst_zero:.0e}",
        ),
        Claim(
            "theory.md §2",
            "f = T^(1−α) (2 sin(ωT/2))^(α−1) cos((α+1)(π−ωT)/2) for unlimited memory",
            verdict(long < 1e-2),
            f"4096 taps, α ≥ 1, ω ≥ 0.05 ω_N: largest difference {long:.1e}",
        ),
        Claim("theory.md §2", "PD: f = −B cos ωT", verdict(cosine < 1e-12), f"largest difference {cosine:.0e}"),
        Claim(
            "theory.md §1",
            "a truncated derivative leaks: D(1) > 0 for 0<α<1, < 0 for 1<α<2 and 3<α<4",
            verdict(all(_leak_sign(a, leak) for a, leak in leaks.items())),
            f"with {taps} taps the largest is at α = {worst_leak}: D(1) = {leaks[worst_leak]:+.3f} of f(ω_N)·2/T",
        ),
    ]


def _leak(order: float, taps: int) -> float:
    """D(1) of a normalised term, in units of 2/T."""
    coefficient, total = 1.0, 1.0
    for m in range(1, taps):
        coefficient *= (m - 1.0 - order) / m
        total += coefficient
    return float(total * 2.0**-order)


def _leak_sign(order: float, leak: float) -> bool:
    if order == math.floor(order):
        return abs(leak) < 1e-12
    return leak > 0.0 if math.floor(order) % 2 == 0 else leak < 0.0


def optimum_terms() -> tuple[Vector, Vector]:
    """Gains and orders of the seed's optimum, normalised.

    Returns
    -------
    tuple of ndarray, shape (2,) each
        A = [1.69, 1.32] and α = [1.50, 3.47].
    """
    terms = PRESETS["paper_optimum"]["terms"]
    return np.array([t["gain"] for t in terms]), np.array([t["order"] for t in terms])


def figure_3(taps: int, points: int = 400) -> dict[str, Vector]:
    """Compute f(ω) of the seed's optimum and of PD.

    Parameters
    ----------
    taps : int
        n + 1; the seed prints no n, flatness of f says 4.
    points : int
        Frequencies.

    Returns
    -------
    dict of str to ndarray
        ``theta``, ``optimum``, ``pd``, and the optimum's two ``terms`` (2, points).
    """
    theta = np.pi * np.arange(1, points + 1) / points
    gains, orders = optimum_terms()
    parts = [damping_curve(theta, gains[i : i + 1], orders[i : i + 1], taps) for i in range(2)]
    return {"theta": theta, "optimum": parts[0] + parts[1], "pd": -np.cos(theta), "terms": np.array(parts)}


def ripple(taps: int, upper: float) -> float:
    """Largest |f + 1| of the seed's optimum over the low and middle range.

    Parameters
    ----------
    taps : int
        n + 1.
    upper : float
        End of the range [ω_N]; it starts at 0.02.

    Returns
    -------
    float
        Ripple.
    """
    gains, orders = optimum_terms()
    theta = np.pi * np.linspace(0.02, upper, 400)
    return float(np.abs(damping_curve(theta, gains, orders, taps) + 1.0).max())


def claims_3(taps: int, period: float) -> list[Claim]:
    """Check what theory.md states about the optimum of figure 3.

    Parameters
    ----------
    taps : int
        n + 1.
    period : float
        Sampling period T of the claim about units [s].

    Returns
    -------
    list of Claim
        Flatness, f(ω_N), the inferred n, the normalisation, the waterbed.
    """
    figure = figure_3(taps)
    gains, orders = optimum_terms()
    nyquist = float(figure["optimum"][-1])
    flat = ripple(taps, 0.5)
    ripples = {n: ripple(n + 1, 0.5) for n in range(1, 33)}
    flattest = min(ripples, key=lambda n: ripples[n])
    # Physical gains share one number A; in seconds a term's weight against the other is (2/T)^(α2 − α1) of the normalised.
    ratio = gains[1] / gains[0] * (2.0 / period) ** float(orders[1] - orders[0])
    seconds = (2.0 / period) ** float(orders[1] - orders[0])
    theta = figure["theta"]
    band = np.flatnonzero(np.abs(figure["optimum"] + 1.0) < 0.1)
    end = float(theta[band[-1]] / math.pi) if len(band) else 0.0
    pd_end = float(math.acos(0.9) / math.pi)
    fine = np.pi * (np.arange(20000) + 0.5) / 20000
    mean = float(damping_curve(fine, gains, orders, taps).mean())
    leak = float(sum(g * _leak(o, taps) for g, o in zip(gains.tolist(), orders.tolist(), strict=True)))
    lowest = float(damping_curve(fine, gains, orders, taps).min())
    return [
        Claim(
            "theory.md §2; seed, eq. (13)",
            "the optimum has f = −1 at low and middle frequencies",
            verdict(flat < 0.02, flat < 0.2),
            f"only if 'about' will do: |f + 1| ≤ {flat:.3f} up to 0.5 ω_N, ≤ 0.1 up to {end:.2f} ω_N "
            f"(PD: up to {pd_end:.2f})",
        ),
        Claim(
            "theory.md §2; seed, eq. (13)",
            "the optimum has f(ω_N) = +1",
            verdict(abs(nyquist - 1.0) < 0.05),
            f"f(ω_N) = {nyquist:+.3f}",
        ),
        Claim(
            "theory.md §2",
            "flatness of f says n = 3 (the seed prints no n)",
            verdict(flattest == 3),
            f"flattest n of 1 … 32 is {flattest}; ripple up to 0.5 ω_N: "
            + ", ".join(f"n={n} {ripples[n]:.3f}" for n in (1, 2, 3, 4, 5, 8)),
        ),
        Claim(
            "theory.md §2",
            "with T in seconds the second term is 10^5 times the first",
            verdict(5.0 <= math.log10(seconds) < 6.5),
            f"T = {period * 1e3:g} ms: (2/T)^(α₂−α₁) = {seconds:.2g}, with the gains {ratio:.2g}: A = [1.69, 1.32] only "
            "means something normalised",
        ),
        Claim(
            "theory.md §2",
            "the mean of f over (0, ω_N) is T·D(1)/2: damping at one frequency is paid at another",
            verdict(abs(mean - leak) < 1e-6),
            f"mean {mean:+.6f}, T·D(1)/2 = {leak:+.6f} (the leak: below 0 it is felt as a softer spring)",
        ),
        Claim(
            "ours, beside theory.md §2",
            "the optimum damps a wider band than PD at the same low-frequency damping",
            verdict(end > pd_end),
            f"f within 0.1 of −1 up to {end:.2f} ω_N against {pd_end:.2f}; lowest f {lowest:.3f}; price f(ω_N) "
            f"{nyquist:+.2f} against +1",
        ),
    ]
