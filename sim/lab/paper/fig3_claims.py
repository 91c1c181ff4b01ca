"""The paper's figure 3 and its claims: f(ω) of its two-term law beside PD."""

import math

import numpy as np

from nodes.laws.presets import PRESETS
from sim.arrays import Array
from sim.lab.paper.claims import Claim, verdict
from sim.lab.paper.descent import damping_curve
from sim.lab.paper.fig2_claims import MEMORIES, for_which, leak_of, order_of_signs


def optimum_terms() -> tuple[Array, Array]:
    """Return the normalised gains and orders of the paper's optimum."""
    terms = PRESETS["paper_optimum"]["terms"]
    return np.array([t["gain"] for t in terms]), np.array([t["order"] for t in terms])


def figure_3(taps: int, points: int = 400) -> dict[str, Array]:
    """Compute f(ω) of the paper's optimum and of PD."""
    theta = np.pi * np.arange(1, points + 1) / points
    gains, orders = optimum_terms()
    parts = [
        damping_curve(theta, gains[i : i + 1], orders[i : i + 1], taps)
        for i in range(2)
    ]
    return {
        "theta": theta,
        "optimum": parts[0] + parts[1],
        "pd": -np.cos(theta),
        "terms": np.array(parts),
    }


def ripple(taps: int, upper: float) -> float:
    """Return the largest |f + 1| of the paper's optimum over the low and middle range."""
    gains, orders = optimum_terms()
    theta = np.pi * np.linspace(0.02, upper, 400)
    return float(np.abs(damping_curve(theta, gains, orders, taps) + 1.0).max())


def claims_3(taps: int, period: float) -> list[Claim]:
    """Judge the claims of the paper and of THEORY.md on figure 3."""
    figure = figure_3(taps)
    theta, gains, orders = figure["theta"], *optimum_terms()

    def against_pd(n: int) -> str:
        return order_of_signs(
            damping_curve(theta, gains, orders, n + 1) + np.cos(theta)
        )

    better = order_of_signs(figure["optimum"] - figure["pd"]) == "-+"
    everywhere = {n: against_pd(n) == "-+" for n in MEMORIES}
    crossing = (
        float(theta[np.flatnonzero(figure["optimum"] < figure["pd"])[-1]] / math.pi)
        if better
        else math.nan
    )
    nyquist = float(figure["optimum"][-1])
    ripples = {n: ripple(n + 1, 0.5) for n in range(1, 33)}
    flattest = min(ripples, key=lambda n: ripples[n])
    # Physical gains share one number A; in seconds the relative weight of a term is (2/T)^(α2
    # − α1) times the normalised.
    seconds = (2.0 / period) ** float(orders[1] - orders[0])
    ratio = gains[1] / gains[0] * seconds
    band = np.flatnonzero(np.abs(figure["optimum"] + 1.0) < 0.15)
    end = float(theta[band[-1]] / math.pi) if len(band) else 0.0
    fine = np.pi * (np.arange(20000) + 0.5) / 20000
    mean = float(damping_curve(fine, gains, orders, taps).mean())
    leak = float(
        sum(
            g * leak_of(o, taps)
            for g, o in zip(gains.tolist(), orders.tolist(), strict=True)
        )
    )
    return [
        Claim(
            "paper, fig. 3",
            "the optimum is more passive than PD at low and middle frequencies, less near ω_N",
            verdict(
                better and all(everywhere.values()), better or any(everywhere.values())
            ),
            f"only if {for_which(everywhere)} (n ≠ 3 loses at low frequencies); n = {taps - 1}: "
            + (f"below PD up to {crossing:.2f} ω_N" if better else "not so"),
        ),
        Claim(
            "paper, eq. (10) and fig. 3",
            "f of the optimum at ω_N is the sum of its gains, 1.69 + 1.32, each term being 1 there",
            verdict(abs(nyquist - float(gains.sum())) < 1e-12),
            f"f(ω_N) = {nyquist:+.3f}: the price of the band below. The paper does not say that"
            " (13) is met at ω_N",
        ),
        Claim(
            "paper, eq. (13)",
            "the optimum is near f = −1 at low and middle frequencies",
            verdict(ripple(taps, 0.5) < 0.02, ripple(taps, 0.5) < 0.2),
            f"only if 'about' will do: |f + 1| ≤ {ripple(taps, 0.5):.3f} up to 0.5 ω_N, ≤ 0.15 up"
            f" to {end:.2f} ω_N (PD: up to {math.acos(0.85) / math.pi:.2f})",
        ),
        Claim(
            "THEORY.md §2",
            "flatness of f says n = 3 (the paper prints no n)",
            verdict(flattest == 3),
            f"flattest n of 1 … 32 is {flattest}; ripple up to 0.5 ω_N: "
            + ", ".join(f"n={n} {ripples[n]:.3f}" for n in (1, 2, 3, 4, 5, 8)),
        ),
        Claim(
            "THEORY.md §2",
            "with T in seconds the second term is 10^5 times the first",
            verdict(5.0 <= math.log10(seconds) < 6.5),
            f"T = {period * 1e3:g} ms: (2/T)^(α₂−α₁) = {seconds:.2g}, with the gains {ratio:.2g}: A"
            " = [1.69, 1.32] only means something normalised",
        ),
        Claim(
            "THEORY.md §2",
            "the mean of f over (0, ω_N) is T·D(1)/2: damping at one frequency is paid at another",
            verdict(abs(mean - leak) < 1e-6),
            f"mean {mean:+.6f}, T·D(1)/2 = {leak:+.6f} (the leak: below 0 it is felt as a softer"
            " spring)",
        ),
    ]
