"""Claims of the paper and THEORY.md on the drop test, judged by `sim.lab.paper.fig4`."""

import itertools
import math
from dataclasses import replace

import numpy as np

from nodes.laws.pd import PD
from nodes.stability.closed_loop import closed_loop
from nodes.stability.k_max import edge_of, k_max, with_spring, without_spring
from nodes.stability.plant import Plant
from sim.lab.paper.claims import Claim, verdict
from sim.lab.paper.fig4 import CUTOFF, DELAYS, LAWS, Curve, Setting, best, published


def claims_4(
    setting: Setting, curves: list[Curve], spreads: list[tuple[float, str, float]]
) -> list[Claim]:
    """Judge the claims of the paper and THEORY.md on the drop test."""
    by = {(c.law, c.delay, c.touch): c for c in curves}
    pd, optimum = by["pd", 0.0, False], by["paper_optimum", 0.0, False]
    others = [name for name in LAWS if name != "pd"]
    return [
        # First in the paper's own unit: nominal K.
        *(
            _against_pd(
                setting,
                by["pd", delay, False],
                by["paper_optimum", delay, False],
                felt=False,
            )
            for delay in (0.0, 1.0)
        ),
        *_thesis(setting, [pd, optimum]),
        _peak_of_pd(setting),
        _conditional(setting, pd),
        *(
            _against_pd(
                setting, by["pd", delay, touch], by[name, delay, touch], felt=True
            )
            for delay in DELAYS
            for touch in (False, True)
            for name in others
            if (name, delay, touch) in by
        ),
        _leak(setting, optimum),
        _conventions(setting, [pd, optimum], spreads),
        _horizon(setting, curves),
        _swing(setting, [pd, optimum]),
    ]


def _peak_of_pd(setting: Setting) -> Claim:
    mass, period = setting.mass, setting.period
    peak = 2.0 * math.sqrt(2.0) - 2.0
    derivative = without_spring(PD(stiffness=1.0, damping=peak * mass / period), period)
    boundary = k_max(derivative, Plant(period, mass, 0.0), "pole_radius").k_max_n_per_m
    kappa = (boundary or 0.0) * period * period / mass
    return Claim(
        "THEORY.md §3",
        "PD, b → 0, d = 0: κ_max peaks at 0.6863 at β = 2√2 − 2",
        verdict(abs(kappa - 0.6863) < 5e-5),
        f"K_max T²/m by pole radius there: {kappa:.5f}",
    )


def _conditional(setting: Setting, pd: Curve) -> Claim:
    passive, stiffest = 2.0 * setting.damping / setting.period, best(pd, felt=True)[0]
    return Claim(
        "THEORY.md §2",
        "on a known device the loop allows more than the passive limit 2b/T: conditional stability",
        verdict(stiffest > passive),
        f"PD settles up to H(1) = {stiffest:.0f} N/m, 2b/T = {passive:.0f} N/m",
    )


def _leak(setting: Setting, optimum: Curve) -> Claim:
    top, where = best(optimum, felt=True)
    nominal = optimum.found[where].k_max_n_per_m or math.nan
    return Claim(
        "THEORY.md §1",
        "nominal K is not the stiffness felt: a truncated term leaks",
        verdict(abs(top / nominal - 1.0) > 0.01),
        f"the paper's optimum at its stiffest, B = {setting.gains[where]:.3g}: K = {nominal:.0f},"
        f" H(1) = {top:.0f} N/m ({100.0 * (top / nominal - 1.0):+.1f} %)",
    )


def _conventions(
    setting: Setting, curves: list[Curve], spreads: list[tuple[float, str, float]]
) -> Claim:
    stiffest = {c.law: setting.gains[best(c, felt=True)[1]] for c in curves}
    anywhere = max(spreads)
    before = max(s for s in spreads if s[2] <= stiffest[s[1]])
    calm = {s[2] for s in spreads} - {s[2] for s in spreads if s[0] > 0.17}
    return Claim(
        "THEORY.md §4",
        "two conventions (history, clamping) change K_max by up to about 17 %",
        verdict(0.12 <= anywhere[0] <= 0.2, bool(calm)),
        f"d = 0, four combinations, PD and optimum: only if {_ranges(setting.gains, calm)} is it up"
        f" to 17 %; below the stiffest point of each law up to {100.0 * before[0]:.1f} %"
        f" ({before[1]}, B = {before[2]:.3g}), anywhere up to {100.0 * anywhere[0]:.0f} %"
        f" ({anywhere[1]}, B = {anywhere[2]:.3g})",
    )


def _horizon(setting: Setting, curves: list[Curve]) -> Claim:
    shares = [
        f.k_max_n_per_m / linear
        for c in curves
        if not c.touch
        for f, linear in zip(c.found, c.linear, strict=True)
        if f.k_max_n_per_m is not None and linear is not None and math.isfinite(linear)
    ]
    middle = sorted(shares)[len(shares) // 2]
    within = sum(0.7 <= s <= 0.99 for s in shares) / len(shares)
    return Claim(
        "THEORY.md §4",
        "the drop test reads 70–99 % of the linear limit",
        verdict(within == 1.0, within > 0.5),
        f"horizon {setting.criterion.ticks} ticks: {100.0 * min(shares):.0f} …"
        f" {100.0 * max(shares):.0f} %, median {100.0 * middle:.0f} %; {100.0 * within:.0f} % of"
        " the points are within",
    )


def _swing(setting: Setting, curves: list[Curve]) -> Claim:
    rings, angles = _rings(setting, curves)
    near = [gain for ratio, gain in rings if abs(ratio - 1.0) < 0.2]
    return Claim(
        "THEORY.md §2",
        "at the limit the known mass rings at about √(K/m)",
        verdict(len(near) == len(rings), bool(near)),
        f"measured/√(K/m), PD and optimum at d = 0: {min(rings)[0]:.2f} … {max(rings)[0]:.2f}; only"
        f" if {_ranges(setting.gains, set(near))} is it within 20 %. Against the angle of the exact"
        f" pole: {min(angles):.3f} … {max(angles):.3f}, median"
        f" {sorted(angles)[len(angles) // 2]:.4f}",
    )


def _rings(
    setting: Setting, curves: list[Curve]
) -> tuple[list[tuple[float, float]], list[float]]:
    """Return the measured swing over √(K/m), with its gain, and over the exact pole's angle."""
    rings, angles = [], []
    for curve in curves:
        family = published(setting)[curve.law]
        for gain, found in zip(setting.gains, curve.found, strict=False):
            if found.frequency_hz is None or found.k_max_n_per_m is None:
                continue
            omega = 2.0 * math.pi * found.frequency_hz
            rings.append((omega / math.sqrt(found.k_max_n_per_m / setting.mass), gain))
            law = with_spring(family(gain), found.k_max_n_per_m)
            poles = np.roots(closed_loop(law, setting.held(curve.delay)))
            slowest = poles[np.argmax(np.abs(poles) - (poles.imag == 0.0))]
            angles.append(omega * setting.period / abs(float(np.angle(slowest))))
    return rings, angles


def _ranges(gains: tuple[float, ...], good: set[float]) -> str:
    """Return the ranges of gains that belong to a set, as text."""
    runs = (
        list(run)
        for yes, run in itertools.groupby(sorted(set(gains)), good.__contains__)
        if yes
    )
    parts = [(run[0], run[-1]) for run in runs]
    return "B = " + " or ".join(
        f"{low:.3g}" if low == high else f"{low:.3g} … {high:.3g}"
        for low, high in parts
    )


_NAMES = {
    "pd_filtered": f"PD with its velocity behind {CUTOFF:g} Hz",
    "pd_windowed": "PD with a windowed velocity",
    "paper_optimum": "the paper's optimum",
    "designed": "a law designed for this delay and half to twice the mass",
    "designed_drop": "a law designed for this very drop",
}


def _against_pd(setting: Setting, pd: Curve, other: Curve, felt: bool) -> Claim:
    name = "h1_max_n_per_m" if felt else "k_max_n_per_m"
    pairs = [
        (getattr(o, name) / getattr(p, name), gain)
        for gain, p, o in zip(setting.gains, pd.found, other.found, strict=False)
        if getattr(p, name) and getattr(o, name)
    ]
    low, high = min(pairs), max(pairs)
    better = {gain for ratio, gain in pairs if ratio > 1.0}
    some = better and len(better) < len(pairs)
    sensor = "Touch X sensor" if other.touch else "perfect sensor"
    condition = (
        f"only if {_ranges(tuple(gain for _, gain in pairs), better)}; " if some else ""
    )
    unit = "in H(1)" if felt else "in nominal K"
    return Claim(
        "paper, fig. 4" if other.law == "paper_optimum" else "THEORY.md §4",
        f"{_NAMES[other.law]} reaches more stiffness than PD at the same B, {unit}, d ="
        f" {other.delay:g}, {sensor}",
        verdict(low[0] > 1.0, bool(better)),
        f"{condition}better at {len(better)} of {len(pairs)} gains, ratio {low[0]:.2f} (B ="
        f" {low[1]:.3g}) … {high[0]:.2f} (B = {high[1]:.3g}); best over B:"
        f" {best(other, felt)[0]:.0f} against {best(pd, felt)[0]:.0f} N/m",
    )


def _thesis(setting: Setting, curves: list[Curve]) -> list[Claim]:
    """Judge the paper's thesis numerically.

    At the limit K = 2 (b R − f(ω_c))/T, and K_max over the sampling period.
    """
    edges = [
        (edge, limit)
        for curve in curves
        for gain, limit in zip(setting.gains, curve.linear, strict=False)
        if limit is not None
        and math.isfinite(limit)
        and (edge := edge_of(published(setting)[curve.law](gain), setting.held(0.0)))
        is not None
    ]
    simple = [edge.k_simple_n_per_m / limit for edge, limit in edges]
    exact = max(abs(edge.k_exact_n_per_m / limit - 1.0) for edge, limit in edges)
    pairs = [
        (
            (optimum.f_n_s_per_m < pd.f_n_s_per_m)
            == (optimum.k_exact_n_per_m > pd.k_exact_n_per_m)
        )
        for gain in setting.gains
        if (pd := edge_of(published(setting)["pd"](gain), setting.held(0.0)))
        is not None
        and (
            optimum := edge_of(
                published(setting)["paper_optimum"](gain), setting.held(0.0)
            )
        )
        is not None
    ]
    tops = [_top(replace(setting, period=period), curves[0].law) for period in _PERIODS]
    return [
        Claim(
            "paper, section 3; THEORY.md §9",
            "the smaller f at the frequency that occurs, the stiffer the wall",
            verdict(all(pairs) and exact < 1e-6),
            f"K_max = 2(bR − f(ω_c))/T to {exact:.0e} at {len(edges)} points of PD and optimum;"
            f" without R: ratio {min(simple):.3f} … {max(simple):.3f}; the law with the smaller"
            f" f(ω_c) is the stiffer one at {sum(pairs)} of {len(pairs)} gains",
        ),
        Claim(
            "paper, introduction",
            "a long sampling period forces a low stiffness",
            verdict(all(a > b for a, b in itertools.pairwise(tops))),
            "best K_max of PD over B, by pole radius: "
            + ", ".join(
                f"T = {1e3 * t:g} ms {k:.0f} N/m"
                for t, k in zip(_PERIODS, tops, strict=True)
            ),
        ),
    ]


_PERIODS = (0.0005, 0.001, 0.002, 0.004)


def _top(setting: Setting, law: str) -> float:
    """Return the largest K_max of a law over gains from 0.1 to twice m/T."""
    family = published(setting)[law]
    gains = np.geomspace(0.1, 2.0 * setting.mass / setting.period, 60).tolist()
    found = (k_max(family(gain), setting.held(0.0)).k_max_n_per_m for gain in gains)
    return max(k for k in found if k is not None and math.isfinite(k))
