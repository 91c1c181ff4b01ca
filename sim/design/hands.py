"""Bounded hands: worst pole radius over a box of grasps, and a stability certificate.

Passivity covers any hand; a massless spring of 0..k covers no real one. A fingertip is in between:
mass, spring and damper, each within limits. The worst grasp is searched on a grid that is refined
around the maximum; that is not a proof. The certificate divides the box into cells. Within a cell,
the matrix of a tick is that of the cell's centre, plus a part linear in the grasp parameters, which
lies in the convex hull of the corners, plus a bounded remainder. A norm in which all of these
contract proves the cell stable (THEORY.md §21).
"""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from nodes.laws import CompiledLaw
from nodes.stability.plant import Plant
from sim.design.demand import Demand
from sim.design.hand_box import HandBox
from sim.design.hands_certificate import CELLS, GraspTicks, certify_box
from sim.stability.every_delay import Certificate
from sim.stability.grasp import Grasp

_POINTS = 5  # grid points per side of the box in the first search
_ZOOMS = 3


# The hand at a stylus: Fu and Çavuşoğlu 2012 (sim/device/real_devices.py), without the arm's own
# spring and damper.
STYLUS = HandBox((0.2, 0.22), (380.0, 770.0), (0.8, 1.8))


@dataclass(frozen=True)
class WorstGrasp:
    """The grasp with the largest pole radius found, and whether the whole box is certified."""

    radius: float  # largest pole radius found over the box
    grasp: Grasp  # the grasp with that radius
    certified: Certificate  # for every grasp of the box; undecided if not requested
    cells: int  # cells the certificate needed


def worst_grasp(
    law: CompiledLaw, plant: Plant, box: HandBox, certify: bool = False
) -> WorstGrasp:
    """Search a box of grasps for the largest pole radius; optionally certify the box.

    `plant`: device, delay and sampling period. The grid is geometric (linear in damping) and is
    refined three times.
    """
    limits: list[Sequence[float]] = list(box.sides)
    best = -math.inf
    at = Grasp(*(side[0] for side in limits))
    ticks = GraspTicks(law, plant)
    for _ in range(1 + _ZOOMS):
        axes = [
            _axis(low, high, linear)
            for (low, high), linear in zip(limits, (False, False, True), strict=True)
        ]
        grasps = np.array(list(itertools.product(*axes)))
        radii = ticks.radii(grasps)
        worst = grasps[int(np.argmax(radii))].tolist()
        if float(radii.max()) > best:
            best = float(radii.max())
            at = Grasp(*worst)
        limits = [_closer(axis, value) for axis, value in zip(axes, worst, strict=True)]
    if best >= 1.0:
        return WorstGrasp(best, at, Certificate.UNSTABLE, 0)
    certified, cells = (
        certify_box(law, plant, box) if certify else (Certificate.UNDECIDED, 0)
    )
    return WorstGrasp(best, at, certified, cells)


@dataclass(frozen=True)
class JudgedGrasps:
    """Result for every grasp of a box, at the ends of a demand's mass, damping and delay."""

    box: HandBox
    worst: WorstGrasp  # over all combinations; certified only if all of them are
    mass: float  # device mass of the worst case [kg]
    delay: float  # delay of the worst case [ticks]

    def text(self) -> str:
        """Return the verdict as a sentence."""
        told = {
            Certificate.CERTIFIED: "every one stable: certified",
            Certificate.UNSTABLE: "NOT every one stable",
            Certificate.UNDECIDED: "all that were tried stable: not certified",
        }
        at = self.worst.grasp
        return (
            f"{self.box.text()}: {told[self.worst.certified]} at the ends of mass and delay;"
            f" largest pole radius {self.worst.radius:.6f}, of {at.mass:.3g} kg, {at.stiffness:.3g}"
            f" N/m, {at.damping:.3g} N s/m (THEORY.md §21)"
        )


def judge_grasps(
    law: CompiledLaw, demand: Demand, box: HandBox, most: int = CELLS
) -> JudgedGrasps:
    """Judge a law for every grasp of a box, at the ends of the demand's ranges."""
    found = []
    for mass, damping, delay in itertools.product(
        sorted(set(demand.mass)),
        sorted(set(demand.dampings)),
        sorted(set(demand.delay)),
    ):
        plant = Plant(demand.period, mass, damping, delay)
        found.append((worst_grasp(law, plant, box), plant))
    worst, where = max(found, key=lambda one: one[0].radius)
    cells = 0
    certified = worst.certified
    if worst.radius < 1.0:
        certified = Certificate.CERTIFIED
        for _, plant in found:
            proven, taken = certify_box(law, plant, box, most - cells)
            cells += taken
            if not proven:
                certified = Certificate.UNDECIDED
                break
    return JudgedGrasps(
        box, replace(worst, certified=certified, cells=cells), where.mass, where.delay
    )


def k_max_over(
    make: Callable[[float], CompiledLaw], plant: Plant, box: HandBox, highest: float
) -> float | None:
    """Bisect the largest nominal stiffness [N/m] with which every grasp of a box is stable.

    The search goes up in steps of 10 %, so it finds the end of the lowest stable interval wider
    than that. Return None if not even 1 % of `highest` is stable.

    make: return the law for a nominal stiffness [N/m].
    highest: end of the search [N/m].
    """

    def stable(stiffness: float) -> bool:
        return worst_grasp(make(stiffness), plant, box).radius < 1.0

    low = 0.01 * highest
    if not stable(low):
        return None
    high = low
    while high < highest and stable(high):
        low = high
        high = min(1.1 * high, highest)
    if stable(high):
        return high
    for _ in range(24):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if stable(middle) else (low, middle)
    return low


def _axis(low: float, high: float, linear: bool) -> list[float]:
    if low == high:
        return [low]
    points = (
        np.linspace(low, high, _POINTS) if linear else np.geomspace(low, high, _POINTS)
    )
    return [float(one) for one in points]


def _closer(axis: list[float], value: float) -> list[float]:
    """Return the grid points next to `value`."""
    i = axis.index(value)
    return [axis[max(i - 1, 0)], axis[min(i + 1, len(axis) - 1)]]
