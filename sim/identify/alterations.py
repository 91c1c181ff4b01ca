"""A device altered by what a recording leaves open, and the stiffest law that it bears."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from nodes.laws import CompiledLaw
from nodes.stability.flexible import FlexiblePlant, flexible_radius
from sim.arrays import Array
from sim.identify import identified_motion as motion
from sim.identify.altered import AlteredDevice
from sim.identify.experiment import Experiment
from sim.identify.judge_fit import Evidence
from sim.identify.output_error import Fit
from sim.identify.suspects import describe


def plant_and_hand(experiment: Experiment, theta: Array) -> FlexiblePlant:
    """Return a fitted device with its hand, its joint and the loop's median delay."""
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


def averaging(plant: FlexiblePlant, average: float) -> FlexiblePlant:
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
        experiment, plant_and_hand(experiment, theta), one, size, own, step
    )
    cause = describe(one.suspect.term, one.suspect.size)
    return AlteredDevice(cause, plant, average, softer, stronger, own_spring)


def change_of(
    experiment: Experiment, device: AlteredDevice, here: float | None, gain: float
) -> float:
    """Return the relative change of K_max by a term; infinite if nothing is stable."""
    changes = []
    for plant in device.plants:
        averaged = averaging(plant, device.average)
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
