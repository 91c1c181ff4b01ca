"""Effect of a significant residual on a design: on K_max and on the device's intervals.

A recording of a few seconds reveals terms without consequence: 1 mN of cogging, half an encoder
step of eccentricity. So a significant term does not refute a model by itself. Each term that
explains part of the residual is added to the device, at the largest size that the windows allow,
and the largest stable stiffness of a reference law gives its effect (model error modelling: Ljung
1999; Reinelt, Garulli & Ljung 2002). Its effect on the unknowns widens their intervals.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nodes.stability.flexible import FlexiblePlant
from sim.arrays import Array
from sim.identify import identified_motion as motion
from sim.identify.alterations import (
    altered,
    averaging,
    change_of,
    plant_and_hand,
    stiffest,
)
from sim.identify.altered import AlteredDevice
from sim.identify.experiment import Experiment
from sim.identify.judge_fit import SURE, Evidence
from sim.identify.output_error import Fit
from sim.identify.suspects import describe

REFUSED = 0.05  # relative change of K_max above which a remainder refutes the model
# gain B of the reference law, in m/(T (1 + 2d)): a PD in the middle of its range
DAMPER = 0.3
# terms that explain this share of what the best one explains are possible causes too
ALTERNATIVE = 0.3
# if the best term explains less, every significant term is a possible cause
CLEAR = 0.5
NAMED = 0.27  # a term must explain at least this share to be named as the cause
# factor on the share of a term with several shapes when a cause is named
FLEXIBLE = 0.6
PARTS = 4  # parts of the run, and of the range of the motion
# Terms whose factor is positive in every device; with a negative factor a term only resembles the
# residual.
POSITIVE = {
    "flexible mode",
    "backlash",
    "actuator lag",
    "sensor filter",
    "presliding",
    "stribeck",
    "quadratic damping",
    "force steps",
}
# largest factor of a term that is complete at 1, with a margin for its grid
WHOLE = 2.0
# number of terms tried, best first; of each further kind only its best size
SHOWN = 8


@dataclass(frozen=True)
class Remainder:
    """What the residual shows and the model lacks."""

    # the term that explains most, in words; empty if the residual is noise
    cause: str = ""
    # share of the residual, beyond rounding, that the term explains
    explained: float = 0.0
    # largest relative change of K_max by any possible cause
    k_max_change: float = 0.0
    # largest change of each unknown of the fit, in the order of `Fit.free`
    moved: tuple[float, ...] = ()
    # the device with each of these terms, for the poles of a law that is designed later
    devices: tuple[AlteredDevice, ...] = ()


NOTHING = Remainder()


def likeliest(seen: Sequence[Evidence]) -> Evidence | None:
    """Return the term to name as the cause.

    A term with several shapes fits anything a little, so only part of its share counts.
    """
    return max(
        seen,
        key=lambda one: one.share * (FLEXIBLE if len(one.suspect.shapes) > 1 else 1.0),
        default=None,
    )


def plant_of(experiment: Experiment, found: Fit) -> FlexiblePlant:
    """Return the linear device of a fit, with the median delay of the loop."""
    return plant_and_hand(experiment, found.theta)


def reference_gain(plant: FlexiblePlant, period: float) -> float:
    """Return the gain B of the reference PD [N s/m]."""
    return DAMPER * plant.mass / (period * (1.0 + 2.0 * plant.delay))


def remainder(
    experiment: Experiment,
    found: Fit,
    evidence: Sequence[Evidence],
    step: float | None = None,
) -> Remainder:
    """Return the largest effect of the terms that a residual shows.

    evidence: all suspects, best first.
    step: encoder step [m].
    """
    seen = [one for one in evidence if one.strength > SURE and _possible(one)]
    plant = plant_of(experiment, found)
    gain = reference_gain(plant, experiment.period)
    average = float(found.theta[motion.AVERAGE])
    here = stiffest(averaging(plant, average), experiment.period, gain, average)
    least = ALTERNATIVE * seen[0].share if seen and seen[0].share >= CLEAR else 0.0
    changes, moved = [0.0], np.zeros(len(found.free))
    devices: list[AlteredDevice] = []
    if not seen or seen[0].share < NAMED:
        # No term tells what it is: how much the parts of the run differ does.
        change, moved, devices = _by_parts(experiment, found, here, gain)
        changes.append(change)
    for one in _alternatives([one for one in seen if one.share >= least]):
        devices.append(altered(experiment, found, one, step or 0.0))
        changes.append(change_of(experiment, devices[-1], here, gain))
        moved = np.maximum(moved, np.abs(_told(found, one)) * (1.0 + one.margin))
    cause, explained = "a residual that no term that was tried explains", 0.0
    first = likeliest(seen)
    if first is not None and first.share >= NAMED:
        cause, explained = describe(first.suspect.term, first.suspect.size), first.share
    return Remainder(
        cause, explained, max(changes), tuple(moved.tolist()), tuple(devices)
    )


def _possible(one: Evidence) -> bool:
    """Check that a device can have a term of this sign and size."""
    factor = float(one.factors[0])
    return one.suspect.term not in POSITIVE or (
        factor > 0.0 and not (one.suspect.term == "force steps" and factor > WHOLE)
    )


def _told(found: Fit, one: Evidence) -> Array:
    """Return a term's effect on the unknowns as they are reported.

    The reported delay includes the mean delay of a lag or a filter.
    """
    moves = one.moves.copy()
    if one.suspect.term in ("actuator lag", "sensor filter"):
        moves[found.free == motion.DELAY] += (
            float(one.factors[0]) * one.suspect.start[0]
        )
    return moves


def _alternatives(seen: Sequence[Evidence]) -> list[Evidence]:
    """Return the best terms, and the best size of each further kind."""
    kinds = {one.suspect.term for one in seen[:SHOWN]}
    first = {one.suspect.term: one for one in reversed(seen)}
    return [*seen[:SHOWN], *(one for term, one in first.items() if term not in kinds)]


def _by_parts(
    experiment: Experiment, found: Fit, here: float | None, gain: float
) -> tuple[float, Array, list[AlteredDevice]]:
    """Return how K_max and the unknowns differ between quarters of a run and of its range.

    K_max as a relative change, with the devices of the parts. Quarters of windows dealt out in turn
    differ by chance alone; of that the fit, their mean, has half.
    """
    windows = np.arange(len(found.starts))
    place = experiment.position[found.starts + found.length // 2]
    ordered = [
        part
        for order in (windows, np.argsort(place))
        for part in np.array_split(order, PARTS)
    ]
    dealt = [
        windows[(windows // times) % PARTS == n]
        for times in (1, 2)
        for n in range(PARTS)
    ]
    steps = [_step_of(found, part) for part in ordered]
    devices = [_part_of_the_run(experiment, found, step) for step in steps]
    # The fit is the mean of the parts, so half of the difference counts.
    moved = 0.5 * np.abs(steps).max(axis=0)
    most = max(change_of(experiment, device, here, gain) for device in devices)
    chance = max(
        change_of(
            experiment,
            _part_of_the_run(experiment, found, _step_of(found, part)),
            here,
            gain,
        )
        for part in dealt
    )
    if not (math.isfinite(most) and math.isfinite(chance)):
        return most, moved, devices
    return max(math.sqrt(max(most**2 - chance**2, 0.0)), 0.5 * chance), moved, devices


def _step_of(found: Fit, windows: NDArray[np.intp]) -> Array:
    """Return how far the unknowns of some windows are from those of the fit."""
    matrix, side = found.matrices[windows].sum(axis=0), found.sides[windows].sum(axis=0)
    return np.asarray(np.linalg.lstsq(matrix, side, rcond=None)[0], dtype=np.float64)


def _part_of_the_run(experiment: Experiment, found: Fit, step: Array) -> AlteredDevice:
    """Return the device of a fit moved by a step of its unknowns."""
    theta = found.theta.copy()
    theta[found.free] += step
    theta[motion.MOBILITY] = max(theta[motion.MOBILITY], 1e-3)
    average = float(np.clip(theta[motion.AVERAGE], 0.0, 0.5))
    return AlteredDevice(
        "a part of the run", plant_and_hand(experiment, theta), average
    )
