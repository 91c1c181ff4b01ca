"""Largest stiffness that settles: raise K until a run no longer settles, then bisect.

This is the paper's method. The lowest settling interval of K counts, so that an island of stability
above the limit does not. The swing of the last run that settled gives the actual frequency there.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import msgspec
import numpy as np

from nodes.laws import CompiledLaw, Law
from nodes.stability.k_max import with_spring, without_spring
from sim.arrays import Array
from sim.experiments.settling import Criterion, linear_at_rest, rest_position, settles
from sim.play.one_axis import run
from sim.play.one_axis_inputs import Scene

LawOfStiffness = Callable[[float], CompiledLaw]
SEARCHED = (1e-3, 4.0)  # lowest and highest K of the search, in units of m/T²


@dataclass(frozen=True)
class SimulatedKMax:
    """Largest nominal stiffness with which a run settles."""

    # Upper end of the lowest settling interval of K [N/m]; None if none settled, infinite if
    # the largest tried did.
    k_max_n_per_m: float | None
    # H(1) there [N/m]; None for a law with own code, which may have none
    h1_max_n_per_m: float | None
    unsettled_n_per_m: float | None  # smallest K above it that did not settle [N/m]
    # frequency of the last swings at K_max [Hz]; None if it did not swing
    frequency_hz: float | None
    ticks: int  # simulated ticks
    # lowest and highest K tried [N/m]
    searched_n_per_m: tuple[float, float] = (math.nan, math.nan)


def at_stiffness(law: Law, period: float) -> LawOfStiffness:
    """Return the law as a function of its nominal stiffness K [N/m], compiled for each.

    A law without a parameter ``stiffness`` gets its spring in tap 0. A law with own code is
    then refused with ValueError, because its code would not use K.
    """
    if "stiffness" in law.__struct_fields__:
        return lambda stiffness: msgspec.structs.replace(
            law, stiffness=stiffness
        ).compile(period)
    if law.compile(period).evaluate is not None:
        raise ValueError(
            f"law kind {law.kind} has code of its own and no parameter 'stiffness' that could be"
            " raised; name its stiffness so"
        )
    derivative = without_spring(law, period)
    return lambda stiffness: with_spring(derivative, stiffness)


def swing_frequency(
    position: Array, period: float, rest: float, smallest: float = 1e-7
) -> float | None:
    """Return the frequency of the last 20 swings about a point [Hz]; None for fewer than 3.

    Upward crossings are interpolated.
    """
    y = position - rest
    up = np.flatnonzero((y[:-1] < 0.0) & (y[1:] >= 0.0))
    instants = [k + y[k] / (y[k] - y[k + 1]) for k in up.tolist()]
    swings = [
        i for i in range(len(up) - 1) if np.ptp(y[up[i] : up[i + 1] + 1]) > smallest
    ]
    gaps = [instants[i + 1] - instants[i] for i in swings]
    if len(gaps) < 2:
        return None
    return float(1.0 / (np.median(gaps[-20:]) * period))


def simulated_k_max(
    law_of_stiffness: LawOfStiffness,
    scene: Scene,
    criterion: Criterion | None = None,
    low: float | None = None,
    high: float | None = None,
    precision: float = 1e-3,
) -> SimulatedKMax:
    """Raise K in steps of 10 % until the run no longer settles, then bisect.

    The default range is `SEARCHED`.
    """
    criterion = criterion or Criterion()
    softest, stiffest = (
        part * scene.device.moving_mass / scene.period**2 for part in SEARCHED
    )
    low = softest if low is None else low
    high = stiffest if high is None else high
    good: float | None = None
    bad: float | None = None
    ticks = 0
    rungs = np.geomspace(
        low, high, 1 + math.ceil(math.log(high / low) / math.log(1.1))
    ).tolist()
    last = low
    # Eight steps at a time: few enough to stop early, enough to use all cores.
    for tried in (rungs[first : first + 8] for first in range(0, len(rungs), 8)):
        laws = _compiled(law_of_stiffness, tried, first=tried[0] == rungs[0])
        ticks += criterion.ticks * len(laws)
        for k, settled in zip(tried, settles(scene, laws, criterion), strict=False):
            if bad is None and settled:
                good = k
            elif bad is None and good is not None:
                bad = k
        last = tried[len(laws) - 1] if laws else last
        if bad is not None or len(laws) < len(tried):
            break
    searched = low, last
    if good is None:
        return SimulatedKMax(None, None, None, None, ticks, searched)
    if bad is None:
        return SimulatedKMax(math.inf, math.inf, None, None, ticks, searched)
    while bad - good > precision * good:
        middle = 0.5 * (good + bad)
        ticks += criterion.ticks
        if settles(scene, [law_of_stiffness(middle)], criterion)[0]:
            good = middle
        else:
            bad = middle
    best = law_of_stiffness(good)
    linear = linear_at_rest(best)
    position = run(scene, best, criterion.ticks).position
    rest = (
        rest_position(scene, best, criterion.ticks)
        if linear
        else float(np.mean(position[-(criterion.ticks // 4) :]))
    )
    swing = None if rest is None else swing_frequency(position, scene.period, rest)
    return SimulatedKMax(good, best.h1 if linear else None, bad, swing, ticks, searched)


def _compiled(
    law_of_stiffness: LawOfStiffness, stiffnesses: list[float], first: bool
) -> list[CompiledLaw]:
    """Compile a law at rising stiffnesses, up to the first that it refuses.

    Raises its error if it refuses the softest.
    """
    laws: list[CompiledLaw] = []
    for stiffness in stiffnesses:
        try:
            laws.append(law_of_stiffness(stiffness))
        except ValueError:
            if first and not laws:
                raise
            break
    return laws
