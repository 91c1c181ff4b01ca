"""The device between two ticks, exact: the force held, and late by any delay.

The virtual device of a simulation (sim/device/model.py) has its own closed forms of the same map.
This module uses the series of the matrix exponential instead, so that each can be tested against
the other.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace
from typing import Any, overload

LONGEST_PERIOD = 1.0  # longest sampling period [s]: what is longer is a rate [Hz]
MAX_DELAY = 1100.0  # longest delay of a loop [ticks]: its matrix has a row and a column for each
_SHORTEST = 1e-15  # fraction of a tick that counts as zero, because of rounding [ticks]


def _checked(name: str, value: Any) -> float:
    """Return a field as a plain number; it must be finite, and positive or not negative."""
    positive = name in ("mass", "period", "rate")
    if (
        isinstance(value, str)
        or not math.isfinite(value)
        or value < 0.0
        or (positive and value == 0.0)
    ):
        raise ValueError(
            f"{name} = {value!r}: must be finite and {'positive' if positive else 'at least 0'}"
        )
    return float(value)


@dataclass(frozen=True)
class Counterpart:
    """The moving body at the other end of a coupling: a tool, or a second device.

    Attributes
    ----------
    mass : float
        Moving mass [kg].
    damping : float
        Viscous damping to ground [N s/m].
    stiffness : float
        Stiffness of a hand, or of a spring to ground [N/m].
    later : float
        Delay of its force relative to that on the device; negative for earlier [ticks].
    """

    mass: float
    damping: float = 0.0
    stiffness: float = 0.0
    later: float = 0.0


@dataclass(frozen=True, init=False)
class Plant:
    """The device that a law is coupled to, including a hand's share, sampled by a loop.

    Attributes
    ----------
    period : float
        Sampling period T [s], at most 1 s; or `rate`, its inverse.
    mass : float
        Moving mass m [kg].
    damping : float
        Viscous damping b [N s/m].
    delay : float
        Delay of the loop, whole or fractional [ticks].
    stiffness : float
        Stiffness of a hand [N/m].
    partner : Counterpart or None
        Moving body at the other end of the coupling; None for a wall or a point.
    rate : float
        Rate of the loop [Hz].

    Raises
    ------
    ValueError
        If a field is out of its limits.
    TypeError
        If mass, damping, or both period and rate are missing.

    Examples
    --------
    >>> Plant(rate=500, mass=0.1, damping=1.0, delay=1.3).period
    0.002
    """

    period: float
    mass: float
    damping: float
    delay: float = 0.0
    stiffness: float = 0.0
    partner: Counterpart | None = None

    @overload
    def __init__(
        self,
        period: float,
        mass: float,
        damping: float,
        delay: float = ...,
        stiffness: float = ...,
        partner: Counterpart | None = ...,
    ) -> None: ...

    @overload
    def __init__(
        self,
        *,
        mass: float,
        damping: float,
        delay: float = ...,
        stiffness: float = ...,
        partner: Counterpart | None = ...,
        rate: float,
    ) -> None: ...

    def __init__(
        self,
        period: float | None = None,
        mass: float | None = None,
        damping: float | None = None,
        delay: float = 0.0,
        stiffness: float = 0.0,
        partner: Counterpart | None = None,
        *,
        rate: float | None = None,
    ) -> None:
        if period is not None and rate is not None:
            raise TypeError("Plant: period and rate are the same quantity; give one")
        if rate is not None:
            period = 1.0 / _checked("rate", rate)
        values = {"period": period, "mass": mass, "damping": damping}
        if missing := [name for name, value in values.items() if value is None]:
            named = ", ".join(missing).replace("period", "period or rate")
            raise TypeError(
                f"Plant: missing {named}; e.g. Plant(rate=500, mass=0.1, damping=1.0)"
            )
        values |= {"delay": delay, "stiffness": stiffness}
        for name, value in values.items():
            object.__setattr__(self, name, _checked(name, value))
        object.__setattr__(self, "partner", partner)
        if self.period > LONGEST_PERIOD:
            raise ValueError(
                f"period = {self.period:g} s: must be at most {LONGEST_PERIOD:g} s; for"
                f" {self.period:g} Hz write rate={self.period:g}"
            )
        if self.delay > MAX_DELAY:
            raise ValueError(
                f"delay = {self.delay!r}: must be at most {MAX_DELAY:g} ticks"
            )
        if partner is not None:
            Plant(
                self.period,
                partner.mass,
                partner.damping,
                self._delay_of_partner,
                partner.stiffness,
            )

    @property
    def rate(self) -> float:
        """Rate of the loop [Hz]."""
        return 1.0 / self.period

    def with_tool(self, mass: float, damping: float = 0.0) -> Plant:
        """Return this device coupled to a tool that is free to move.

        Pressed on a wall the tool no longer moves, and the device alone counts.

        Parameters
        ----------
        mass : float
            Mass of the tool [kg].
        damping : float
            Viscous damping of the tool to ground [N s/m].

        Returns
        -------
        Plant
            With the tool as its `partner`, pushed as late as the device.
        """
        return replace(self, partner=Counterpart(mass, damping))

    def paired_with(self, other: Plant) -> Plant:
        """Return this device coupled to another one, position to position, by one law.

        Parameters
        ----------
        other : Plant
            The other device, with the delay of its own loop; its period must be equal.

        Returns
        -------
        Plant
            With the other one as its `partner`.
        """
        return replace(
            self,
            partner=Counterpart(
                other.mass, other.damping, other.stiffness, other.delay - self.delay
            ),
        )

    @property
    def other(self) -> Plant | None:
        """The partner as a device of its own in the same loop; None without one."""
        if self.partner is None:
            return None
        whom = self.partner
        return Plant(
            self.period, whom.mass, whom.damping, self._delay_of_partner, whom.stiffness
        )

    @property
    def _delay_of_partner(self) -> float:
        """Delay of the partner [ticks]; rounding below 0 is 0."""
        delay = self.delay + (0.0 if self.partner is None else self.partner.later)
        return 0.0 if -1e-12 < delay < 0.0 else delay

    @property
    def anchored(self) -> bool:
        """Whether a spring ties the device, or its partner, to ground."""
        return self.stiffness > 0.0 or (
            self.partner is not None and self.partner.stiffness > 0.0
        )

    @property
    def damping_of_any_hand(self) -> float:
        """Damping that a proof for any hand may use [N s/m]; b b'/(b + b') for two devices."""
        if self.partner is None:
            return self.damping
        both = self.damping * self.partner.damping
        return both / (self.damping + self.partner.damping) if both > 0.0 else 0.0


@dataclass(frozen=True)
class HeldPlant:
    """The device as a rational function of z, its force held and delayed.

    x/u = (numerator[0] z² + numerator[1] z + numerator[2]) / (z^{whole+1} (z² + denominator[1] z +
    denominator[2])), u the force on the device, with or without the stiffness of a hand.
    """

    whole: int  # whole ticks i of the delay d = i + φ
    numerator: tuple[float, float, float]  # [m/N]
    denominator: tuple[float, float, float]


def held_plant(plant: Plant) -> HeldPlant:
    """Discretise m x'' + b x' + k x = u exactly for a held force that is `delay` ticks late."""
    whole, transition, new, old = held_step(plant)
    a11, a12, _, a22 = transition
    # first row of adj(zI − A) times each input vector: (z − a22) g1 + a12 g2
    new_1 = new[0]
    new_0 = a12 * new[1] - a22 * new[0]
    old_1 = old[0]
    old_0 = a12 * old[1] - a22 * old[0]
    determinant = math.exp(-plant.damping * plant.period / plant.mass)
    # tr A = 1 + det A − k·(...), written so that the pole of a free device is exactly at z = 1
    trace = 1.0 + determinant if plant.stiffness == 0.0 else a11 + a22
    return HeldPlant(whole, (new_1, new_0 + old_1, old_0), (1.0, -trace, determinant))


# a search uses the same few devices thousands of times
@functools.lru_cache(maxsize=1024)
def held_step(
    plant: Plant,
) -> tuple[
    int, tuple[float, float, float, float], tuple[float, float], tuple[float, float]
]:
    """Return one tick of m x'' + b x' + k x = u in position and velocity.

    Whole ticks of the delay; a11, a12, a21, a22 of the free motion [1], [s], [1/s], [1]; position
    and velocity per force [m/N], [m/(N s)], of the force that arrives within this tick, and of the
    one before it.
    """
    mass = plant.mass
    damping = plant.damping
    stiffness = plant.stiffness
    period = plant.period
    whole = math.floor(plant.delay)
    fraction = plant.delay - whole
    if fraction < _SHORTEST:
        fraction = 0.0
    a11, a12, a21, a22, g1, g2 = _transition(mass, damping, stiffness, period)
    if fraction == 0.0:
        return whole, (a11, a12, a21, a22), (g1, g2), (0.0, 0.0)
    late = _transition(mass, damping, stiffness, (1.0 - fraction) * period)
    early = _transition(mass, damping, stiffness, fraction * period)
    older = (
        late[0] * early[4] + late[1] * early[5],
        late[2] * early[4] + late[3] * early[5],
    )
    return whole, (a11, a12, a21, a22), late[4:], older


def _transition(
    mass: float, damping: float, stiffness: float, duration: float
) -> tuple[float, float, float, float, float, float]:
    """Return the exact map of position and velocity under a held force.

    It is the series of the matrix exponential, with halving and squaring.
    """
    halvings = max(
        0,
        math.ceil(
            math.log2(
                max(
                    damping / mass * duration,
                    math.sqrt(stiffness / mass) * duration,
                    0.25,
                )
            )
        )
        + 2,
    )
    h = duration / 2.0**halvings
    # Series of φ(t), the response to a unit force: x = Σ c_j t^j/j!, from the equation itself.
    older = 0.0
    newer = h * h / (2.0 * mass)
    g1 = newer
    g2 = h / mass
    for j in range(1, 40):
        term = (
            -(damping / mass * h / (j + 2)) * newer
            - (stiffness / mass * h * h / ((j + 1) * (j + 2))) * older
        )
        g1 += term
        g2 += term * (j + 2) / h
        older, newer = newer, term
        if abs(newer) + abs(older) < 1e-20 * g1:
            break
    a12 = mass * g2
    a11 = 1.0 - stiffness * g1
    a21 = -stiffness * g2
    a22 = a11 - damping * g2
    for _ in range(halvings):
        g1, g2 = a11 * g1 + a12 * g2 + g1, a21 * g1 + a22 * g2 + g2
        a11, a12, a21, a22 = (
            a11 * a11 + a12 * a21,
            a11 * a12 + a12 * a22,
            a21 * a11 + a22 * a21,
            a21 * a12 + a22 * a22,
        )
    return a11, a12, a21, a22, g1, g2
