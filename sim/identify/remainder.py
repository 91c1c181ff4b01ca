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
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from nodes.laws import CompiledLaw
from nodes.stability.flexible import FlexiblePlant, flexible_radius
from sim.arrays import Array
from sim.identify import identified_motion as motion
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
CLEAR = (
    0.5  # if the best term explains less, every significant term is a possible cause
)
NAMED = 0.27  # a term must explain at least this share to be named as the cause
FLEXIBLE = (
    0.6  # factor on the share of a term with several shapes when a cause is named
)
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
WHOLE = (
    2.0  # largest factor of a term that is complete at 1, with a margin for its grid
)
# number of terms tried, best first; of each further kind only its best size
SHOWN = 8


@dataclass(frozen=True)
class Remainder:
    """What the residual shows and the model lacks."""

    # the term that explains most, in words; empty if the residual is noise
    cause: str = ""
    explained: float = (
        0.0  # share of the residual, beyond rounding, that the term explains
    )
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
    return _plant(experiment, found.theta)


def _plant(experiment: Experiment, theta: Array) -> FlexiblePlant:
    mass = 1.0 / float(theta[motion.MOBILITY])
    late = float(np.median(experiment.delay)) if len(experiment.delay) else 0.0
    joint = {}
    if theta[motion.SHARE] > 0.0:
        joint = {
            "share": float(theta[motion.SHARE]),
            "frequency": float(theta[motion.FREQUENCY]),
            "loss": max(float(theta[motion.LOSS]), 0.0),
        }
    return FlexiblePlant(
        mass,
        max(float(theta[motion.DAMPING]), 0.0) * mass,
        max(late + float(theta[motion.DELAY]) + float(theta[motion.AVERAGE]), 0.0),
        max(float(theta[motion.STIFFNESS]), 0.0) * mass,
        max(float(theta[motion.LAG]), 0.0) * experiment.period,
        **joint,
    )


def reference_gain(plant: FlexiblePlant, period: float) -> float:
    """Return the gain B of the reference PD [N s/m]."""
    return DAMPER * plant.mass / (period * (1.0 + 2.0 * plant.delay))


def stiffest(
    plant: FlexiblePlant, period: float, gain: float, average: float = 0.0
) -> float | None:
    """Return K_max [N/m] of a PD on a flexible device; None if no K is stable.

    The law is behind a sensor that averages. All boundaries lie on one curve K = −1/P(z) − D(z)
    over the unit circle, as in `nodes.stability.k_max`.
    """
    whole, numerator, denominator = plant.rational(period)
    mode = (
        2.0 * math.pi * plant.frequency * period
        if math.isfinite(plant.frequency)
        else math.pi
    )
    near = mode * (1.0 + np.linspace(-0.2, 0.2, 801))
    grid = np.union1d(
        np.linspace(0.0, math.pi, 4001)[1:-1], np.geomspace(1e-6, math.pi, 801)[:-1]
    )
    grid = np.union1d(grid, near[(near > 0.0) & (near < math.pi)])
    w = np.exp(-1j * grid)
    z = 1.0 / w
    device = (
        np.polyval(numerator, z)
        / (np.polyval(denominator, z) * z ** (whole + 1))
        * (1.0 - average + average * w)
    )
    curve = -1.0 / device - gain / period * (1.0 - w)
    turns = np.flatnonzero(curve.imag[:-1] * curve.imag[1:] < 0.0)
    part = curve.imag[turns] / (curve.imag[turns] - curve.imag[turns + 1])
    cuts = np.append(
        curve.real[turns] + part * (curve.real[turns + 1] - curve.real[turns]),
        curve.real[-1],
    )
    # A spring that pushes away has to be held first.
    low = max(0.0, -plant.stiffness)
    for cut in np.sort(cuts[cuts > low]).tolist():
        if (
            flexible_radius(
                _pd(0.5 * (low + cut), gain, period, average), period, plant
            )
            < 1.0
        ):
            return float(cut)
        low = cut
    return None


def _pd(stiffness: float, gain: float, period: float, average: float) -> CompiledLaw:
    """Return a PD behind an averaging sensor: the convolution of their taps."""
    taps = np.convolve(
        [stiffness + gain / period, -gain / period], [1.0 - average, average]
    )
    return CompiledLaw(tuple(float(tap) for tap in taps))


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
    here = stiffest(_averaging(plant, average), experiment.period, gain, average)
    least = ALTERNATIVE * seen[0].share if seen and seen[0].share >= CLEAR else 0.0
    changes, moved = [0.0], np.zeros(len(found.free))
    devices: list[AlteredDevice] = []
    if not seen or seen[0].share < NAMED:
        # No term tells what it is: how much the parts of the run differ does.
        change, moved, devices = _by_parts(experiment, found, here, gain)
        changes.append(change)
    for one in _alternatives([one for one in seen if one.share >= least]):
        devices.append(altered(experiment, found, one, step or 0.0))
        changes.append(_change(experiment, devices[-1], here, gain))
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
    most = max(_change(experiment, device, here, gain) for device in devices)
    chance = max(
        _change(
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
    return AlteredDevice("a part of the run", _plant(experiment, theta), average)


def _averaging(plant: FlexiblePlant, average: float) -> FlexiblePlant:
    """Return a plant without the mean delay of its averaging sensor, which is in the law."""
    return replace(plant, delay=max(plant.delay - average, 0.0))


def altered(
    experiment: Experiment, found: Fit, one: Evidence, step: float = 0.0
) -> AlteredDevice:
    """Return the device of a fit with one term at the largest size the windows allow.

    Parameters
    ----------
    experiment : Experiment
        The run.
    found : Fit
        The fit without the term.
    one : Evidence
        The term.
    step : float
        Step of the encoder [m].
    """
    size = 1.0 + one.margin
    theta = found.theta.copy()
    theta[found.free] += one.moves * size
    theta[motion.MOBILITY] = max(theta[motion.MOBILITY], 1e-3)
    own = float(theta[motion.AVERAGE])
    plant, average, softer, stronger, own_spring = _with(
        experiment, _plant(experiment, theta), one, size, own, step
    )
    cause = describe(one.suspect.term, one.suspect.size)
    return AlteredDevice(cause, plant, average, softer, stronger, own_spring)


def _change(
    experiment: Experiment, device: AlteredDevice, here: float | None, gain: float
) -> float:
    """Return the relative change of K_max by a term; infinite if nothing is stable."""
    changes = []
    for plant in device.plants:
        averaged = _averaging(plant, device.average)
        there = stiffest(averaged, experiment.period, gain, device.average)
        if here is None or there is None:
            changes.append(0.0 if here is there else math.inf)
            continue
        # Springs beside the law's own and a gain before it act at once, at any K.
        lowest = (there - device.spring) / device.gain
        changes.append(max(abs(there / here - 1.0), 1.0 - lowest / here))
    return max(changes)


def _with(
    experiment: Experiment,
    plant: FlexiblePlant,
    one: Evidence,
    size: float,
    own: float,
    step: float,
) -> tuple[FlexiblePlant, float, float, float, float]:
    """Return a device with a term.

    The values are the plant, the sensor's weight of the previous sample, a spring beside the law's
    [N/m], the gain [1] and a spring of the device itself [N/m].
    """
    term, factor, period, mass = (
        one.suspect.term,
        float(one.factors[0]) * size,
        experiment.period,
        plant.mass,
    )
    factors = np.abs(one.factors) * size
    average, spring, gain, own_spring = own, 0.0, 1.0, 0.0
    if term == "flexible mode" and factor > 0.0 and plant.rigid:
        share = min(factor / (1.0 + factor), 0.95)
        plant = replace(
            plant,
            share=share,
            frequency=one.suspect.start[1],
            loss=one.suspect.start[2],
        )
    elif term == "backlash" and factor > 0.0:
        # Within the gap only the motor side moves.
        plant = replace(plant, mass=mass / (1.0 + factor))
    elif term == "actuator lag" and factor > 0.0 and plant.lag == 0.0:
        # A share of a lag blurs like a shorter lag, of which the square is that share; the mean
        # delay is unchanged.
        lag = one.suspect.start[0]
        short = lag * math.sqrt(factor)
        plant = replace(
            plant,
            lag=short * period,
            delay=max(plant.delay + factor * lag - short, 0.0),
        )
    elif term == "sensor filter" and factor > 0.0 and own == 0.0:
        part = one.suspect.start[0]
        blur, late = factor * part * (1.0 - part), plant.delay + factor * part
        if blur <= 0.25:
            average = 0.5 * (1.0 - math.sqrt(1.0 - 4.0 * blur))
            plant = replace(plant, delay=max(late, 0.0))
        elif plant.lag == 0.0:
            # Two samples cannot blur more: a longer filter, equal to a lag of the same square.
            plant = replace(
                plant,
                lag=math.sqrt(blur) * period,
                delay=max(late - math.sqrt(blur), 0.0),
            )
    elif term == "spring":
        reach = float(np.ptp(experiment.position)) / 2.0
        spring = mass * float(
            factors @ np.array([1.0, 2.0 * reach, 3.0 * reach**2])[: len(factors)]
        )
    elif term == "cogging":
        own_spring = (
            mass * float(np.linalg.norm(factors)) * 2.0 * math.pi / one.suspect.size
        )
    elif term == "encoder ripple":
        gain = 1.0 + float(np.linalg.norm(factors)) * 2.0 * math.pi / one.suspect.size
    elif term == "presliding" and one.suspect.size > step:
        # Below one encoder step it equals the friction of the model.
        own_spring = mass * float(factors[0]) / one.suspect.size
    elif term == "gain by sign":
        gain = 1.0 + factors[0]
    elif term == "deadband":
        # Steepest where the force is 0 or where it is largest.
        strongest = one.suspect.start[0]
        gain = 1.0 + size * max(
            0.0,
            float(one.factors[0]) / (0.1 * strongest),
            2.0 * float(one.factors[1]) * strongest,
        )
    elif term == "drift":
        plant = replace(
            plant, damping=max(plant.damping - 0.5 * mass * factors[0], 0.0)
        )
    return plant, average, float(spring), float(gain), own_spring
