"""Kinds of worlds that a coupling renders, and the stiffness certified for all of a kind.

A wall is not the worst world. A certificate depends on the worlds that it covers, so each kind
names them: their integration, delay and damping (THEORY.md §18).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from nodes.laws import CompiledLaw
from nodes.stability.closed_loop import pole_radius
from nodes.stability.dips import Reals
from nodes.stability.k_max import k_max, with_spring
from nodes.stability.k_window import Window, k_window, outside
from nodes.stability.loop_region import Disc, Region
from nodes.stability.plant import MAX_DELAY, Plant
from nodes.stability.spring_world import spring_window, stable_with_springs, wall_swings


@dataclass(frozen=True)
class Wall:
    """A surface that does not move."""

    @property
    def about(self) -> str:
        """Description of these worlds."""
        return "a wall"


@dataclass(frozen=True)
class Springs:
    """A spring between surface and ground, settled in the same tick; any stiffness of a range."""

    softest: float  # [N/m]
    stiffest: float = math.inf  # [N/m]; infinite: up to a wall

    def __post_init__(self) -> None:
        """Check the range."""
        if not 0.0 < self.softest <= self.stiffest:
            raise ValueError(
                f"softest = {self.softest!r}, stiffest = {self.stiffest!r} N/m: expected 0 <"
                " softest <= stiffest"
            )

    @property
    def about(self) -> str:
        """Description of these worlds."""
        return (
            f"a spring of {self.softest:g} to {self.stiffest:g} N/m"
            " that answers in the same tick"
        )


@dataclass(frozen=True)
class AnyWorld:
    """Every passive world that answers in the same tick: implicit bodies, springs, proxies."""

    @property
    def about(self) -> str:
        """Description of these worlds."""
        return (
            "any passive world that answers in the same tick (implicit or lossless, a static"
            " spring, a proxy)"
        )


@dataclass(frozen=True)
class SteppedTool:
    """A tool with viscous damping to ground, anything passive attached, stepped.

    Sub-steps do not matter: holding the force over any number of implicit or exact sub-steps is
    covered.
    """

    damping: float  # of the tool to ground [N s/m]
    # from the sample to the force that moves the tool; None: as late as on the device [ticks]
    delay: float | None = None
    # Semi-implicit Euler steps a tick with all behind the tool implicit: a heavier tool is a remedy
    # too. None: other steps, or springs that are not implicit.
    steps: int | None = None

    def __post_init__(self) -> None:
        """Check damping and delay."""
        _check_damped(self.damping, self.delay)

    @property
    def about(self) -> str:
        """Description of these worlds."""
        if self.damping == 0.0:
            return "a stepped tool without damping to the ground, of which nothing is provable"
        late = (
            "as late as on the device"
            if self.delay is None
            else f"{self.delay:g} ticks late"
        )
        return (
            f"a stepped tool of at least {self.damping:g} N s/m to the ground with anything passive"
            f" hung on it (force held, {late}, any sub-steps)"
        )


@dataclass(frozen=True)
class EulerTool:
    """A tool of known mass, stepped by semi-implicit Euler, implicit bodies behind it."""

    mass: float  # least mass of the tool [kg]
    steps: int = 1  # of the integrator in a tick, the force held
    damping: float = 0.0  # of the tool to the ground, solved implicitly [N s/m]
    # from the sample to the force that moves the tool, to the nearest step [ticks]
    delay: float = 0.0

    def __post_init__(self) -> None:
        """Check the mass."""
        if not (math.isfinite(self.mass) and self.mass > 0.0):
            raise ValueError(
                f"mass = {self.mass!r} kg: expected a finite value above 0"
            )
        _check_damped(self.damping, self.delay)
        if self.steps < 1:
            raise ValueError(f"steps = {self.steps!r}: expected at least 1")

    @property
    def about(self) -> str:
        """Description of these worlds."""
        count = "one step" if self.steps == 1 else f"{self.steps} steps"
        damped = f" and {self.damping:g} N s/m to the ground" if self.damping else ""
        late = f", the force {self.delay:g} ticks late" if self.delay else ""
        return (
            f"a tool of at least {self.mass:g} kg{damped}, {count} of semi-implicit Euler a"
            f" tick{late}, with any passive bodies behind it that are solved implicitly"
        )


@dataclass(frozen=True)
class OtherDevice:
    """A second device on the same law, in any hand; the deflection is their distance."""

    damping: float  # [N s/m]
    delay: float  # of its loop [ticks]

    def __post_init__(self) -> None:
        """Check damping and delay."""
        _check_damped(self.damping, self.delay)

    @property
    def about(self) -> str:
        """Description of these worlds."""
        return f"a second device of {self.damping:g} N s/m at {self.delay:g} ticks, in any hand"


def _check_damped(damping: float, delay: float | None) -> None:
    """Check that a damping is finite and at least 0, and a delay within the loop's limits."""
    if not 0.0 <= damping < math.inf:
        raise ValueError(
            f"damping = {damping!r} N s/m: expected a finite value of at least 0"
        )
    if delay is not None and not 0.0 <= delay <= MAX_DELAY:
        raise ValueError(f"delay = {delay!r} ticks: expected 0 to {MAX_DELAY:g}")


WorldKind: TypeAlias = Wall | Springs | AnyWorld | SteppedTool | EulerTool | OtherDevice


@dataclass(frozen=True)
class WorldKMax:
    """Largest certified stiffness for one kind of world."""

    # nominal stiffness [N/m]; None: none is certified; infinite: all are
    k_max_n_per_m: float | None
    low_n_per_m: float | None  # lower end of the window [N/m]
    frequency_hz: float | None  # frequency at which the upper end is reached [Hz]
    about: str  # worlds and hands of the certificate


def region_of(plant: Plant, world: WorldKind, any_hand: bool) -> Region:
    """Return the region of device and world; for `Springs` see `nodes.stability.spring_world`.

    Parameters
    ----------
    plant : Plant
        The device and its loop; with `any_hand` its mass and its hand are ignored.
    world : WorldKind
        The kind of world.
    any_hand : bool
        Whether every passive hand may hold the device; else the hand is that of the plant.
    """
    refuse_partner(plant)
    known, hands = (
        (None, (held_disc(plant, plant.damping, plant.delay),))
        if any_hand
        else (plant, ())
    )
    if isinstance(world, AnyWorld):
        return Region(plant.period, known, hands, any_world=True)
    if isinstance(world, Wall):
        return Region(plant.period, known, hands)
    if isinstance(world, SteppedTool):
        late = plant.delay if world.delay is None else world.delay
        return Region(
            plant.period, known, (*hands, held_disc(plant, world.damping, late))
        )
    if isinstance(world, OtherDevice):
        return Region(
            plant.period, known, (*hands, held_disc(plant, world.damping, world.delay))
        )
    if isinstance(world, EulerTool):
        disc = euler_disc(plant, world.mass, world.steps, world.damping, world.delay)
        return Region(plant.period, known, (*hands, disc))
    raise ValueError("world: springs of a range are no region; use spring_window")


def refuse_partner(plant: Plant) -> None:
    """Reject a plant with a partner, which a certificate names as a kind of world."""
    if plant.partner is not None:
        raise ValueError(
            "plant.partner: judge the device alone, and name the partner as its world: OtherDevice"
            " or SteppedTool"
        )


def held_disc(plant: Plant, damping: float, delay: float) -> Disc:
    """Return the disc of everything passive that a held force moves against a damper."""
    return Disc(0.5 * plant.period / damping, delay)


def euler_disc(
    plant: Plant, mass: float, steps: int = 1, damping: float = 0.0, delay: float = 0.0
) -> Disc:
    """Return the disc of a mass stepped by semi-implicit Euler, anything implicit attached.

    In a step of h = T/n velocity over force is a point of the disc about 1/2g with radius 1/2g,
    g = m (1 − cos θ_i)/h + b_t. A force that is held over n steps meets the n aliases
    θ_i = (ωT + 2πi)/n with the weights sin²(ωT/2)/(n sin(θ_i/2))², whose sum is 1 (THEORY.md §18).
    A force that comes some steps late turns each alias by its own angle.
    """
    step = plant.period / steps
    late = round(delay * steps)

    def sizes(theta: Reals) -> list[Reals]:
        found = []
        for i in range(steps):
            sine = np.sin((0.5 * theta + math.pi * i) / steps) ** 2
            own = 2.0 * mass * sine / step + damping
            found.append(np.sin(0.5 * theta) ** 2 / (steps**2 * sine) / own)
        return found

    def radius(theta: Reals) -> Reals:
        return np.asarray(0.5 * plant.period * sum(sizes(theta)), dtype=np.float64)

    def aliases(theta: Reals) -> list[tuple[Reals, Reals]]:
        own = sizes(theta)
        whole = sum(own)
        return [
            (size / whole, theta + late * (theta + 2.0 * math.pi * i) / steps)
            for i, size in enumerate(own)
        ]

    if late % steps == 0:
        return Disc(radius, float(late // steps))
    return Disc(radius, late / steps, aliases)


def world_k_max(
    derivative: CompiledLaw, plant: Plant, world: WorldKind, any_hand: bool = False
) -> WorldKMax:
    """Return the largest nominal stiffness that is certified for every world of a kind.

    Parameters
    ----------
    derivative : CompiledLaw
        The law without its spring (`nodes.stability.k_max.without_spring`).
    plant : Plant
        The device and its loop; its partner is ignored, the world takes its place. Without damping
        only a wall or a spring is certified.
    world : WorldKind
        The kind of world.
    any_hand : bool
        Whether every passive hand may hold the device; else the hand is that of the plant.

    Returns
    -------
    WorldKMax
        The edge, and the worlds that it covers.

    Raises
    ------
    ValueError
        For a law with own code, which has no transfer function; for springs with any hand.
    """
    plant = replace(plant, partner=None)
    if derivative.evaluate is not None:
        raise ValueError(
            "law: has code of its own and no transfer function; use --method simulation or lockstep"
        )
    about = f"{world.about}; {hand_text(plant, any_hand)}"
    none = WorldKMax(None, None, None, about)
    if isinstance(world, Wall) and not any_hand:
        wall = k_max(derivative, plant)
        return (
            none
            if not wall.stable
            else WorldKMax(wall.k_max_n_per_m, wall.stable[0][0], None, about)
        )
    if isinstance(world, Springs) and any_hand:
        raise ValueError(
            "world: springs are certified for a known device only; any hand: AnyWorld"
        )
    if undamped(plant, world) and not isinstance(world, Springs):
        return none
    try:
        with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
            window = _window(derivative, plant, world, any_hand)
    except ArithmeticError:
        return none  # a double overflows, e.g. with a mass of 1e300 kg
    if window is None:
        return none
    finite = math.isfinite(window.high_n_per_m)
    where = window.theta / (2.0 * math.pi * plant.period) if finite else None
    return WorldKMax(window.high_n_per_m, window.low_n_per_m, where, about)


def _window(
    derivative: CompiledLaw, plant: Plant, world: WorldKind, any_hand: bool
) -> Window | None:
    if isinstance(world, Springs):
        return spring_window(derivative, plant, world.softest, world.stiffest)

    def stable(stiffness: float) -> bool:
        return is_stable(with_spring(derivative, stiffness), plant)

    return k_window(
        derivative,
        region_of(plant, world, any_hand),
        stable,
        wall_swings(derivative, plant),
    )


def is_stable(law: CompiledLaw, plant: Plant) -> bool:
    """Return whether the loop of a law and a device against a wall is stable."""
    return pole_radius(law, plant) < 1.0


def undamped(plant: Plant, world: WorldKind) -> bool:
    """Return whether device or tool lack the damping that every proof needs."""
    return plant.damping == 0.0 or (
        isinstance(world, SteppedTool | OtherDevice) and world.damping == 0.0
    )


def hand_text(plant: Plant, any_hand: bool) -> str:
    """Return a description of the hands that a certificate covers."""
    if any_hand:
        return (
            f"a device of at least {plant.damping:g} N s/m, its hand's share included, in any"
            " passive hand"
        )
    hand = f" and a hand of {plant.stiffness:g} N/m" if plant.stiffness else ""
    return f"the known device of {plant.mass:g} kg, {plant.damping:g} N s/m{hand}"


def certified(
    law: CompiledLaw, plant: Plant, world: WorldKind, any_hand: bool = False
) -> bool:
    """Return whether a law is certified for every world of a kind (see `world_k_max`)."""
    plant = replace(plant, partner=None)
    if law.evaluate is not None:
        raise ValueError("law: has code of its own and no transfer function")
    if not (law.h1 > 0.0 and is_stable(law, plant)):
        return False
    if isinstance(world, Springs):
        return stable_with_springs(law, plant, world.softest, world.stiffest)
    if isinstance(world, Wall) and not any_hand:
        return True
    return not undamped(plant, world) and outside(
        law, region_of(plant, world, any_hand)
    )
