"""What a designed law must keep, and the law that was found."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nodes.laws import CompiledLaw

Vector = NDArray[np.float64]

CONVENTIONS = ((False, True), (False, False), (True, True), (True, False))
"""Of contact: (raw, clamp), which history, and whether forces into the floor are set to zero."""

RIGID = (0.0, 0.0, math.inf, 0.0)
"""What a device has beyond one rigid mass when it has nothing: lag, share, frequency and damping ratio of a joint."""


@dataclass(frozen=True)
class Demand:
    """What a law must keep, whatever its stiffness.

    Attributes
    ----------
    mass : tuple of float, shape (2,)
        Lightest and heaviest device, a hand's share included [kg].
    damping : float
        Viscous damping b of the device, the least of it where it is a range [N s/m].
    delay : tuple of float, shape (2,)
        Shortest and longest delay of the loop, fractions allowed [ticks].
    period : float
        Sampling period T [s].
    radius : float
        Largest pole radius R allowed at any mass, delay and hand of the ranges.
    nyquist : float
        Largest |H(−1)| allowed [N/m].
    stiffness : tuple of float, shape (2,)
        Softest and stiffest hand [N/m].
    damping_max : float or None
        Most damping of the device; None where it is known [N s/m].
    lands : tuple of (bool, bool)
        Contact conventions (raw history, clamped force) under which every drop must settle too, with a margin
        (`sim.design.landing`); empty when landing is not asked for.
    above : float
        H(1) that is known already: laws below it are not dropped, and need not be found [N/m].
    beyond : tuple of (float, float, float, float)
        What the device may have beyond one rigid mass, all of which are kept: lag of the actuator [s], part of the mass
        behind a joint, its frequency [Hz] and damping ratio. Empty for a rigid device.
    """

    mass: tuple[float, float]
    damping: float
    delay: tuple[float, float]
    period: float
    radius: float
    nyquist: float
    stiffness: tuple[float, float] = (0.0, 0.0)
    damping_max: float | None = None
    lands: tuple[tuple[bool, bool], ...] = ()
    above: float = 0.0
    beyond: tuple[tuple[float, float, float, float], ...] = ()

    @property
    def dampings(self) -> tuple[float, float]:
        """Least and most damping of the device [N s/m]."""
        return self.damping, self.damping if self.damping_max is None else self.damping_max


@dataclass(frozen=True)
class Robust:
    """The stiffest law found in a family.

    Attributes
    ----------
    taps : ndarray, shape (n + 1,)
        h_0 ... h_n, or the numerator over 1 − pole·w [N/m].
    parameters : ndarray, shape (p,)
        Weights of the family's basis.
    h1_n_per_m : float
        H(1) [N/m].
    h_nyquist_n_per_m : float
        H(−1) [N/m].
    radius : float
        Largest pole radius over all verified cases.
    worst : tuple of float, shape (4,)
        The case where that is: mass [kg], delay [ticks], stiffness of the hand [N/m], damping of the device [N s/m].
    pole : float
        Of a filter behind two taps (`pd_filtered`); 0 without one.
    """

    taps: Vector
    parameters: Vector
    h1_n_per_m: float
    h_nyquist_n_per_m: float
    radius: float
    worst: tuple[float, ...]
    pole: float = 0.0

    @property
    def law(self) -> CompiledLaw:
        """The law as the coupling renders it.

        Returns
        -------
        CompiledLaw
            Taps, or a tap and a section.
        """
        return filtered(self.taps, self.pole)


def filtered(taps: Vector, pole: float) -> CompiledLaw:
    """Compile taps, or two of them over 1 − pole·w: a spring, and a difference behind the filter.

    Parameters
    ----------
    taps : ndarray, shape (n + 1,)
        h_0 ... h_n, or the two of the numerator [N/m].
    pole : float
        Of the filter; 0 without one.

    Returns
    -------
    CompiledLaw
        The law.
    """
    if pole == 0.0:
        return CompiledLaw(tuple(taps.tolist()))
    newest, older = taps.tolist()
    spring = (newest + older) / (1.0 - pole)
    return CompiledLaw((spring,), ((newest - spring, spring - newest, -pole, 0.0),))
