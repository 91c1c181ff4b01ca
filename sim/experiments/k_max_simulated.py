"""The largest stiffness that still settles: K raised until a run no longer does, then bisected.

That is how the paper finds its K_max. The lowest interval of K that settles counts, so that an island of stability beyond the
limit does not; and the swing of the last run that settled tells the frequency that really occurs there.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from nodes.laws import CompiledLaw
from sim.arrays import Array
from sim.experiments.drop import Criterion, rest_position, settles
from sim.scene.loop import Scene, run

LawOfStiffness = Callable[[float], CompiledLaw]
SEARCHED = (1e-3, 4.0)  # softest and stiffest K that are tried, in units of m/T²


@dataclass(frozen=True)
class SimulatedKMax:
    """Where raising the nominal stiffness stops a run from settling."""

    # Largest K that settled, of the lowest interval that does [N/m]; None when none did, infinite when the stiffest that was
    # tried did.
    k_max_n_per_m: float | None
    h1_max_n_per_m: float | None  # H(1) there [N/m]
    unsettled_n_per_m: float | None  # smallest K above it that did not [N/m]
    frequency_hz: float | None  # frequency of the last swings seen at K_max [Hz]; None when it did not swing
    ticks: int  # simulated ticks


def swing_frequency(position: Array, period: float, rest: float, smallest: float = 1e-7) -> float | None:
    """Frequency of the last 20 swings about a point [Hz], by interpolated upward crossings; None with less than three."""
    y = position - rest
    up = np.flatnonzero((y[:-1] < 0.0) & (y[1:] >= 0.0))
    instants = [k + y[k] / (y[k] - y[k + 1]) for k in up.tolist()]
    swings = [i for i in range(len(up) - 1) if np.ptp(y[up[i] : up[i + 1] + 1]) > smallest]
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
    """Raise K in steps of 10 % until the run no longer settles, then bisect; by default over `SEARCHED`."""
    criterion = criterion or Criterion()
    softest, stiffest = (part * scene.device.moving_mass / scene.period**2 for part in SEARCHED)
    low = softest if low is None else low
    high = stiffest if high is None else high
    good: float | None = None
    bad: float | None = None
    ticks = 0
    rungs = np.geomspace(low, high, 1 + math.ceil(math.log(high / low) / math.log(1.1))).tolist()
    # Eight rungs at a time: few enough to stop early, enough to keep the cores busy.
    for tried in (rungs[first : first + 8] for first in range(0, len(rungs), 8)):
        ticks += criterion.ticks * len(tried)
        for k, settled in zip(tried, settles(scene, [law_of_stiffness(k) for k in tried], criterion), strict=True):
            if bad is None and settled:
                good = k
            elif bad is None and good is not None:
                bad = k
        if bad is not None:
            break
    if good is None:
        return SimulatedKMax(None, None, None, None, ticks)
    if bad is None:
        return SimulatedKMax(math.inf, math.inf, None, None, ticks)
    while bad - good > precision * good:
        middle = 0.5 * (good + bad)
        ticks += criterion.ticks
        if settles(scene, [law_of_stiffness(middle)], criterion)[0]:
            good = middle
        else:
            bad = middle
    best = law_of_stiffness(good)
    rest = rest_position(scene, best, criterion.ticks)
    swing = None if rest is None else swing_frequency(run(scene, best, criterion.ticks).position, scene.period, rest)
    return SimulatedKMax(good, best.h1, bad, swing, ticks)
