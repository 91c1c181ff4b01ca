"""Accuracy against stiffness at equal demand: the value of a better derivative.

Each realisation has its own best gain, so the gain of every law is tuned to one demand: pole radius
over a range of mass at one tick of delay, and a bound on |H(−1)|. At a radius of 0.99 a derivative
with a longer memory fails by its own memory, so plain stability is a demand too. The baselines of
D^1 are PD and PD with a filtered velocity; a windowed velocity has no poles (`sim.lab.paper.fig4`).
"""

import functools
import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from nodes.laws import CompiledLaw
from nodes.laws.pd_filtered import PDFiltered
from nodes.stability.closed_loop import pole_radius
from nodes.stability.k_max import without_spring
from nodes.stability.plant import Plant
from sim.lab.charts.derivative_errors import analyse
from sim.lab.charts.derivatives import (
    DAMPING,
    DELAY,
    PERIOD,
    candidates,
    with_stiffness,
)
from sim.lab.charts.points import Extra, Group, Point
from sim.measure.jobs import Runner

ORDERS = (0.5, 1.0, 1.5)
MASSES, NYQUIST = (0.05, 0.1, 0.2), 1e4
RADII = {"calm": 0.99, "stable": 1.0 - 1e-9}
CUTOFFS = (50.0, 100.0, 200.0)  # of the filtered velocity [Hz]
_LONGEST, _QUICK_LONGEST = 64, 8
_GAINS, _STIFFNESSES = np.geomspace(0.5, 40.0, 14), np.geomspace(6000.0, 200.0, 26)
# Factors about the best gain so far, searched next with nine gains each; and the relative
# precision of the stiffness.
_NEARER, _PRECISION = (1.4, 1.1, 1.03, 1.008), 1e-4
# distinct realisations of D^1; all others equal PD's difference
_FIRST = {("gl", 4), ("bdf2", 4), ("bdf3", 4)}
MakeLaw = Callable[[float, float], CompiledLaw]


def keeps(law: CompiledLaw, radius: float) -> bool:
    """Return whether a law meets the demand, checking the lightest device first."""
    return abs(law.h_nyquist) <= NYQUIST and all(
        pole_radius(law, Plant(PERIOD, mass, DAMPING, DELAY)) <= radius
        for mass in MASSES
    )


def tuned(way: MakeLaw, radius: float) -> tuple[float, float]:
    """Return the largest stiffness that meets the demand, and its gain; both 0 if none."""
    best, at, gains = 0.0, 0.0, _GAINS
    # The limit has kinks: at the best gain two masses bind, so a coarse gain grid loses
    # stiffness.
    for spread in (*_NEARER, 1.0):
        for gain in gains.tolist():
            kept = next(
                (
                    k
                    for k in _STIFFNESSES.tolist()
                    if k > best and keeps(way(k, gain), radius)
                ),
                None,
            )
            if kept is None and not (
                best > 0.0 and keeps(way(best * (1.0 + _PRECISION), gain), radius)
            ):
                continue
            low, high = (
                kept or best,
                (kept or best) * float(_STIFFNESSES[0] / _STIFFNESSES[1]),
            )
            while high > (1.0 + _PRECISION) * low:
                middle = math.sqrt(low * high)
                low, high = (
                    (middle, high)
                    if keeps(way(middle, gain), radius)
                    else (low, middle)
                )
            best, at = low, gain
        gains = np.geomspace(at / spread, at * spread, 9) if at else gains[:0]
    return best, at


def laws(order: float, quick: bool) -> Iterator[tuple[str, str, MakeLaw, float]]:
    """Yield the laws to compare.

    Each has a name, a family, the law as a function of stiffness and gain, and the error of its
    derivative.
    """
    for kind, taps, unit in candidates(order, quick):
        if len(unit.taps) <= (_QUICK_LONGEST if quick else _LONGEST) and (
            order != 1.0 or (kind, taps) in _FIRST
        ):
            yield (
                "pd" if (order, kind) == (1.0, "gl") else f"{kind} {taps}",
                kind,
                lambda k, g, unit=unit: with_stiffness(unit, k, g, order, PERIOD),  # type: ignore[misc]
                analyse(kind, order, taps, PERIOD)["error_aligned"],
            )
    if order == 1.0:
        for cutoff in CUTOFFS[1:2] if quick else CUTOFFS:
            unit = without_spring(
                PDFiltered(stiffness=1.0, damping=1.0, cutoff=cutoff), PERIOD
            )
            yield (
                f"pd_filtered {cutoff:g} Hz",
                "pd_filtered",
                lambda k, g, unit=unit: with_stiffness(unit, k, g, 1.0, PERIOD),  # type: ignore[misc]
                analyse("pd_filtered", 1.0, 2, PERIOD, unit)["error_aligned"],
            )


@functools.cache
def _listed(order: float, quick: bool) -> list[tuple[str, str, MakeLaw, float]]:
    return list(laws(order, quick))


def _row(
    order: float, quick: bool, number: int, radius: float
) -> tuple[str, str, float, float, float]:
    """Tune one realisation; return name, family, derivative error, stiffness and gain."""
    name, family, way, error = _listed(order, quick)[number]
    return name, family, error, *tuned(way, radius)


def demand_groups(
    step: Callable[[str], None], quick: bool, spread: Runner
) -> list[Group]:
    """Tune every realisation to the same demand."""
    groups = [(order, demand) for order in ORDERS for demand in RADII]
    jobs: list[Callable[[], Any]] = [
        functools.partial(_row, order, quick, number, RADII[demand])
        for order, demand in groups
        for number in range(len(_listed(order, quick)))
    ]
    rows = iter(spread(jobs, lambda done, _: step(f"equal demand: {done}")))
    return [
        _group(
            order, demand, RADII[demand], [next(rows) for _ in _listed(order, quick)]
        )
        for order, demand in groups
    ]


def _group(
    order: float,
    demand: str,
    radius: float,
    rows: list[tuple[str, str, float, float, float]],
) -> Group:
    best = max(stiffness for *_, stiffness, _ in rows)
    points = []
    for name, family, error, stiffness, gain in rows:
        detail: dict[str, Extra] = {
            "order": order,
            "h1_tuned_n_per_m": stiffness,
            "gain_tuned_n_s_per_m": gain,
        }
        points.append(Point(name, error, 1.0 - stiffness / best, family, detail))
    return Group(
        f"equal_demand_{order:g}_{demand}",
        f"D^{order:g}: accuracy and stiffness at equal demand, pole radius ≤ {radius:.3g}",
        "relative error of the derivative, best delay removed (rms) [1]",
        f"stiffness lost against the best, {best:.0f} N/m [1]",
        tuple(points),
        f"Gain and K tuned for each: pole radius ≤ {radius:.3g} for"
        f" {', '.join(f'{m:g}' for m in MASSES)} kg, b = {DAMPING:g} N s/m, {DELAY:g} tick of"
        f" delay, |H(−1)| ≤ {NYQUIST:g} N/m, T = {1e3 * PERIOD:g} ms. At 1: keeps the demand with"
        " no gain. pd_windowed has no poles: `haptic study design --compare` tunes it by drops.",
        linear=True,
    )


def demand_steps(quick: bool = False) -> int:
    """Return the number of steps of `demand_groups`."""
    return len(RADII) * sum(1 for order in ORDERS for _ in laws(order, quick))
