"""What a designed law must keep, and the law that was found."""

from __future__ import annotations

import math
from dataclasses import dataclass

from nodes.laws import CompiledLaw
from sim.arrays import Array

CONVENTIONS = ((False, True), (False, False), (True, True), (True, False))
"""Of contact: (raw, clamp), which history, and whether forces into the floor are set to zero."""

RIGID = (0.0, 0.0, math.inf, 0.0)
"""What a device has beyond one rigid mass when it has nothing: lag, share, frequency and damping ratio of a joint."""


@dataclass(frozen=True)
class Demand:
    """What a law must keep, whatever its stiffness."""

    mass: tuple[float, float]  # lightest and heaviest device, a hand's share included [kg], shape (2,)
    damping: float  # viscous damping b of the device, the least of it where it is a range [N s/m]
    delay: tuple[float, float]  # shortest and longest delay of the loop, fractions allowed [ticks], shape (2,)
    period: float  # sampling period T [s]
    radius: float  # largest pole radius R allowed at any mass, delay and hand of the ranges
    nyquist: float  # largest |H(−1)| allowed [N/m]
    stiffness: tuple[float, float] = (0.0, 0.0)  # softest and stiffest hand [N/m], shape (2,)
    damping_max: float | None = None  # most damping of the device; None where it is known [N s/m]
    # Contact conventions (raw history, clamped force) under which every drop must settle too, with a margin
    # (`sim.design.landing`); empty when landing is not asked for.
    lands: tuple[tuple[bool, bool], ...] = ()
    above: float = 0.0  # H(1) that is known already: laws below it are not dropped, and need not be found [N/m]
    # What the device may have beyond one rigid mass, all of which are kept: lag of the actuator [s], part of the mass behind a
    # joint, its frequency [Hz] and damping ratio. Empty for a rigid device.
    beyond: tuple[tuple[float, float, float, float], ...] = ()

    @property
    def dampings(self) -> tuple[float, float]:
        """Least and most damping of the device [N s/m]."""
        return self.damping, self.damping if self.damping_max is None else self.damping_max


@dataclass(frozen=True)
class Robust:
    """The stiffest law found in a family."""

    # h_0 ... h_n, or the numerator over 1 − pole·w [N/m], shape (n + 1,).
    taps: Array
    parameters: Array  # weights of the family's basis, shape (p,)
    h1_n_per_m: float  # H(1) [N/m]
    h_nyquist_n_per_m: float  # H(−1) [N/m]
    radius: float  # largest pole radius over all verified cases
    # The case where that is: mass [kg], delay [ticks], stiffness of the hand [N/m], damping of the device [N s/m], shape (4,).
    worst: tuple[float, ...]
    pole: float = 0.0  # of a filter behind two taps (`pd_filtered`); 0 without one

    @property
    def law(self) -> CompiledLaw:
        """The law as the coupling renders it.

        Returns: taps, or a tap and a section.
        """
        return filtered(self.taps, self.pole)


def filtered(taps: Array, pole: float) -> CompiledLaw:
    """Compile taps, or two of them over 1 − pole·w: a spring, and a difference behind the filter.

    `taps`, shape (n + 1,): h_0 ... h_n, or the two of the numerator [N/m]. `pole`: of the filter; 0 without one.
    """
    if pole == 0.0:
        return CompiledLaw(tuple(taps.tolist()))
    newest, older = taps.tolist()
    spring = (newest + older) / (1.0 - pole)
    return CompiledLaw((spring,), ((newest - spring, spring - newest, -pole, 0.0),))
