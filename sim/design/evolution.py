"""Differential evolution over taps in compiled code: starts for the linear programs.

The Schur–Cohn recursion decides whether all poles of a case are within a radius, in about 0.1 µs
for a law of eight taps. How far outside they are is bisected, only while a candidate may still win.

`scipy.optimize.differential_evolution` calls Python for each candidate. On the same demand (50 to
200 g, one tick), with as many members and generations and the same compiled pole test, it takes at
least 14 times the processor time (4 taps: the same 3356 N/m; 7 taps: 6500 N/m, here 6700 N/m).
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from nodes.compiled.kernels.sources import kernel
from sim.arrays import Array
from sim.design.demand import CONVENTIONS, LoopCase
from sim.design.fall import Falls, falls, settles_one
from sim.design.linear_family import LinearFamily
from sim.measure.cancelling import check
from sim.play.compiled import compiled

_uniform, _integer = np.random.uniform, np.random.randint

_BOXES = (
    0.3,
    0.1,
    0.03,
    0.01,
    0.003,
)  # half-widths of the boxes around the best member


@kernel
def _within(fixed: Any, by_tap: Any, taps: Any, radius: float, work: Any) -> bool:
    """Check that all roots of one case are within a radius."""
    size = len(fixed)
    power = 1.0
    for i in range(size):
        total = fixed[i]
        for j in range(len(taps)):
            total += taps[j] * by_tap[j, i]
        work[0, i] = total * power
        power /= radius
    for m in range(size - 1, 0, -1):
        k = work[0, m] / work[0, 0]
        if not -1.0 < k < 1.0:
            return False
        for j in range(m):
            work[1, j] = work[0, j] - k * work[0, m - j]
        for j in range(m):
            work[0, j] = work[1, j]
    return True


@kernel
def _excess(
    fixed: Any, by_tap: Any, taps: Any, radius: float, enough: float, work: Any
) -> tuple[float, int]:
    """Return the excess of the worst pole radius over `radius`, and its case (−1: none).

    The excess is not searched beyond `enough`.
    """
    reached = radius
    worst = -1
    for i in range(len(fixed)):
        if _within(fixed[i], by_tap[i], taps, reached, work):
            continue
        low = reached
        high = 2.0 * reached
        # Every law has a finite radius, unless its taps are not numbers.
        while high < 1e6 and not _within(fixed[i], by_tap[i], taps, high, work):
            low = high
            high = 2.0 * high
        for _ in range(20):
            middle = 0.5 * (low + high)
            if _within(fixed[i], by_tap[i], taps, middle, work):
                high = middle
            else:
                low = middle
        reached, worst = high, i
        if reached - radius > enough:
            break
    return reached - radius, worst


@kernel
def _lands(
    drops: Any, taps: Any, pole: float, ticks: int, tolerance: float, first: int
) -> tuple[float, int]:
    """Return the share of drops that settle before the first failure, and the failed drop.

    Drop `first` is tried first. The share is 1 for a law that passes all drops.
    """
    if len(drops.whole) == 0:
        return 1.0, 0
    spring = taps
    recursive = np.empty(0)
    if pole != 0.0:
        stiffness = (taps[0] + taps[1]) / (1.0 - pole)
        spring = np.array([stiffness])
        recursive = np.array([taps[0] - stiffness, stiffness - taps[0], -pole, 0.0])
    if not settles_one(first, drops, spring, recursive, ticks, tolerance, True):
        return 0.0, first
    for i in range(len(drops.whole)):
        if i != first and not settles_one(
            i, drops, spring, recursive, ticks, tolerance, True
        ):
            return i / len(drops.whole), i
    return 1.0, first


# Long: one compiled function; calls would cost more than they save.
def _evolve(  # noqa: C901
    fixed: Any,
    by_tap: Any,
    basis: Any,
    gain: Any,
    noise: Any,
    quiet: float,
    radius: float,
    box: Any,
    start: Any,
    size: int,
    generations: int,
    seed: int,
    least: float,
    drops: Any,
    pole: float,
    ticks: int,
    tolerance: float,
) -> tuple[Any, float]:
    # In compiled code this is numba's own generator, local to this thread.
    np.random.seed(seed)  # noqa: NPY002
    p, n = basis.shape
    work = np.empty((2, fixed.shape[1]))
    members = np.empty((size, p))
    scores = np.full(size, np.inf)
    tried = np.empty(p)
    taps = np.empty(n)
    best, failed, broken = 0, 0, 0
    for g in range(generations + 1):
        weight = _uniform(0.5, 1.0)
        for i in range(size):
            one, other, kept = _integer(size), _integer(size), _integer(p)
            for j in range(p):
                if g == 0:
                    tried[j] = start[j] if i == 0 else _uniform(box[0, j], box[1, j])
                elif j == kept or _uniform(0.0, 1.0) < 0.9:
                    tried[j] = members[best, j] + weight * (
                        members[one, j] - members[other, j]
                    )
                    if not box[0, j] <= tried[j] <= box[1, j]:
                        tried[j] = _uniform(box[0, j], box[1, j])
                else:
                    tried[j] = members[i, j]
            felt, loud = 0.0, 0.0
            for j in range(p):
                felt += gain[j] * tried[j]
                loud += noise[j] * tried[j]
            # Feasible members compete by H(1), the others by their distance from feasibility, so
            # that none of them can win.
            outside = max(abs(loud) - quiet, 0.0)
            if -felt > scores[i] or (
                outside > 0.0 and 1.0 + 10.0 * outside > scores[i]
            ):
                continue
            for m in range(n):
                taps[m] = 0.0
                for j in range(p):
                    taps[m] += tried[j] * basis[j, m]
            if scores[i] <= 1.0 and not _within(
                fixed[broken], by_tap[broken], taps, radius, work
            ):
                # An infeasible candidate is rejected against a feasible member; the case that
                # failed last is tried first.
                continue
            excess, case = _excess(
                fixed, by_tap, taps, radius, max(0.1 * (scores[i] - 1.0), 0.0), work
            )
            outside += excess
            broken = case if case >= 0 else broken
            score = 1.0 + 10.0 * outside if outside > 0.0 else -felt
            if outside == 0.0 and felt > least:
                # Laws that settle compete by H(1), the others by the number of drops that settle.
                # Against a member that settles, the drop that failed last is tried first.
                share, failed = _lands(
                    drops,
                    taps,
                    pole,
                    ticks,
                    tolerance,
                    failed if scores[i] < 0.0 else 0,
                )
                score = 1.0 - share if share < 1.0 else score
            elif outside == 0.0:
                # Not stiffer than a known law, even if all drops settle.
                score = 1.0
            if score <= scores[i]:
                members[i], scores[i] = tried, score
        best = int(np.argmin(scores))
        if len(drops.whole) > 0 and scores.max() < scores[best] + 2e-4 * abs(
            scores[best]
        ):
            # All members are nearly equal, and each drop costs time.
            break
        if scores[best] == scores.max() and np.all(members == members[best]):
            # All members are equal to the last bit: further generations would not differ.
            break
    return members[best], scores[best]


# evolve, compiled: the best member and its score; a score below 0 meets the demand
evolve: Any = compiled()(_evolve)


def evolved(
    family: LinearFamily, loops: Sequence[LoopCase], span: float, radius: float
) -> Array | None:
    """Evolve in a wide box, then in boxes that shrink around the best member.

    The wide box uses the first cases; with more than three parameters, the smaller boxes use more
    cases, the last one all of them. Return None if nothing feasible is found.
    """
    demand, p = family.demand, len(family.basis)
    here = np.zeros(p)
    # Empty arrays in place of None, whose different type would cost a second compilation (6 s).
    columns = falls(demand, demand.mass[:1], CONVENTIONS[:1], (0.0,))
    no_drops = Falls(*(column[:0] for column in columns))
    nothing_lands = (-math.inf, no_drops, 0.0, 0, 0.0)
    # With two or three parameters the linear programs find the rest.
    for i, width in enumerate((span, *_BOXES) if p > 3 else (span,)):
        check()
        # The last box enforces the bound in all cases.
        loop = loops[(0, 1, 1, 1, 1, 2)[i]]
        box = family.box(here, width)
        members = 30 * p if i else 60 * p
        generations = (20 + 20 * p if i else 100 + 100 * p) * family.effort
        given = family.evolving(loop, radius)
        here, score = evolve(
            *given, box, here, members, generations, family.seed, *nothing_lands
        )
        if not score < 0.0:
            return None
    return here
