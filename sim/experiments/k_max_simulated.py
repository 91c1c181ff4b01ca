"""The largest stiffness that still settles: K raised until a run no longer does, then bisected, for many laws at once.

That is how the paper finds its K_max. The lowest interval of K that settles counts, so that an island of stability beyond the
limit does not; and the swing of the last run that settled tells the frequency that really occurs there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numba
import numpy as np

from nodes.laws import CompiledLaw
from sim.arrays import Array
from sim.experiments.drop import Criterion, rest_position, settles
from sim.scene.loop import Scene, run

LawOfStiffness = Callable[[float], CompiledLaw]


@dataclass(frozen=True)
class SimulatedKMax:
    """Where raising the nominal stiffness stops a run from settling."""

    # Largest K that settled, of the lowest interval that does [N/m]; None when none did, infinite when all above it did.
    k_max_n_per_m: float | None
    h1_max_n_per_m: float | None  # H(1) there [N/m]
    unsettled_n_per_m: float | None  # smallest K above it that did not [N/m]
    frequency_hz: float | None  # frequency of the last swings seen at K_max [Hz]; None when it did not swing
    ticks: int  # simulated ticks


class SearchInterrupted(KeyboardInterrupt):
    """Ctrl-C during a search: what was found until then, in the order of the laws."""

    def __init__(self, found: list[SimulatedKMax]) -> None:
        super().__init__()
        self.found = found


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
    """Raise K in steps of 10 % until the run no longer settles, then bisect; by default from 10⁻³ to 4 times m/T²."""
    return simulated_boundary([law_of_stiffness], scene, criterion, low, high, precision)[0]


def simulated_boundary(
    laws_of_stiffness: Sequence[LawOfStiffness],
    scene: Scene,
    criterion: Criterion | None = None,
    low: float | None = None,
    high: float | None = None,
    precision: float = 1e-3,
    step: Callable[[str, int], None] | None = None,
) -> list[SimulatedKMax]:
    """Find K_max of many laws, each a function of its nominal K, spread over the cores; Ctrl-C raises SearchInterrupted."""
    criterion = Criterion() if criterion is None else criterion
    unit = scene.device.moving_mass / scene.period**2
    low = 1e-3 * unit if low is None else low
    high = 4.0 * unit if high is None else high
    found: list[SimulatedKMax] = []
    group = 4 * numba.get_num_threads()
    try:
        for i in range(0, len(laws_of_stiffness), group):
            done = _search(laws_of_stiffness[i : i + group], scene, criterion, low, high, precision)
            found += done
            if step is not None:
                step("K_max by simulation", len(done))
    except KeyboardInterrupt as interrupt:
        raise SearchInterrupted(found) from interrupt
    return found


def _search(
    laws: Sequence[LawOfStiffness], scene: Scene, criterion: Criterion, low: float, high: float, precision: float
) -> list[SimulatedKMax]:
    rungs = np.geomspace(low, high, 1 + math.ceil(math.log(high / low) / math.log(1.1))).tolist()
    good: list[float | None] = [None] * len(laws)
    bad: list[float | None] = [None] * len(laws)
    ticks = [0] * len(laws)
    # Eight rungs at a time: few enough to stop early, enough to keep the cores busy with few laws.
    for first in range(0, len(rungs), 8):
        going = [i for i in range(len(laws)) if bad[i] is None]
        tried = [(i, k) for i in going for k in rungs[first : first + 8]]
        if not tried:
            break
        for (i, k), settled in zip(tried, settles(scene, [laws[i](k) for i, k in tried], criterion), strict=True):
            ticks[i] += criterion.ticks
            if bad[i] is None and settled:
                good[i] = k
            elif bad[i] is None and good[i] is not None:
                bad[i] = k
    while True:
        tried = [
            (i, 0.5 * (below + above))
            for i, (below, above) in enumerate(zip(good, bad, strict=True))
            if below is not None and above is not None and above - below > precision * below
        ]
        if not tried:
            break
        for (i, k), settled in zip(tried, settles(scene, [laws[i](k) for i, k in tried], criterion), strict=True):
            ticks[i] += criterion.ticks
            (good if settled else bad)[i] = k
    return [_result(laws[i], scene, criterion, good[i], bad[i], ticks[i]) for i in range(len(laws))]


def _result(
    law: LawOfStiffness, scene: Scene, criterion: Criterion, good: float | None, bad: float | None, ticks: int
) -> SimulatedKMax:
    if good is None:
        return SimulatedKMax(None, None, None, None, ticks)
    if bad is None:
        return SimulatedKMax(math.inf, math.inf, None, None, ticks)
    best = law(good)
    rest = rest_position(scene, best, criterion.ticks)
    swing = None if rest is None else swing_frequency(run(scene, best, criterion.ticks).position, scene.period, rest)
    return SimulatedKMax(good, best.h1, bad, swing, ticks)
