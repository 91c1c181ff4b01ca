"""Worlds that a coupling may be asked to render, and the stiffness and damping that are certified for all of one kind.

A wall is not the worst world. Which worlds a certificate is about decides everything, so each kind
names them: how they are integrated, how late they answer, what damping they have (THEORY.md §18).
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
        """Which worlds these are."""
        return "a wall"


@dataclass(frozen=True)
class Springs:
    """A spring between surface and ground, at rest in the same tick; any stiffness of a range."""

    softest: float  # [N/m]
    stiffest: float = math.inf  # [N/m]; infinite: up to a wall

    def __post_init__(self) -> None:
        """Refuse an empty range."""
        if not 0.0 < self.softest <= self.stiffest:
            raise ValueError(
                f"softest = {self.softest!r}, stiffest = {self.stiffest!r} N/m: expected 0 <"
                " softest <= stiffest"
            )

    @property
    def about(self) -> str:
        """Which worlds these are."""
        return (
            f"a spring of {self.softest:g} to {self.stiffest:g} N/m that answers in the same tick"
        )


@dataclass(frozen=True)
class AnyWorld:
    """Every passive world that answers the force in the same tick: implicit and lossless bodies, static springs, proxies."""

    @property
    def about(self) -> str:
        """Which worlds these are."""
        return (
            "any passive world that answers in the same tick (implicit or lossless, a static"
            " spring, a proxy)"
        )


@dataclass(frozen=True)
class SteppedTool:
    """A tool with viscous damping to the ground and anything passive hung on it, stepped with the force held.

    Sub-steps do not matter: a hold of the force over any number of implicit or exact sub-steps is
    covered.
    """

    damping: float  # of the tool to the ground [N s/m]
    # from the sample to the force that moves the tool; None: as late as on the device [ticks]
    delay: float | None = None

    def __post_init__(self) -> None:
        """Refuse a tool that promises nothing."""
        _check_damped(self.damping, self.delay)

    @property
    def about(self) -> str:
        """Which worlds these are."""
        if self.damping == 0.0:
            return "a stepped tool without damping to the ground, of which nothing is provable"
        late = "as late as on the device" if self.delay is None else f"{self.delay:g} ticks late"
        return (
            f"a stepped tool of at least {self.damping:g} N s/m to the ground with anything passive"
            f" hung on it (force held, {late}, any sub-steps)"
        )


@dataclass(frozen=True)
class EulerTool:
    """A tool of known mass, stepped once a tick by semi-implicit Euler, with implicit passive bodies behind it."""

    mass: float  # least mass of the tool [kg]

    def __post_init__(self) -> None:
        """Refuse a tool without mass."""
        if not (math.isfinite(self.mass) and self.mass > 0.0):
            raise ValueError(f"mass = {self.mass!r} kg: expected a finite value above 0")

    @property
    def about(self) -> str:
        """Which worlds these are."""
        return (
            f"a tool of at least {self.mass:g} kg, one step of semi-implicit Euler a tick, "
            "with any passive bodies behind it that are solved implicitly"
        )


@dataclass(frozen=True)
class OtherDevice:
    """A second device on the same law, its deflection the way between the two, in any hand."""

    damping: float  # [N s/m]
    delay: float  # of its loop [ticks]

    def __post_init__(self) -> None:
        """Refuse what no device is."""
        _check_damped(self.damping, self.delay)

    @property
    def about(self) -> str:
        """Which worlds these are."""
        return f"a second device of {self.damping:g} N s/m at {self.delay:g} ticks, in any hand"


def _check_damped(damping: float, delay: float | None) -> None:
    """Refuse a damping that is negative or not finite, and a delay that no loop has."""
    if not 0.0 <= damping < math.inf:
        raise ValueError(f"damping = {damping!r} N s/m: expected a finite value of at least 0")
    if delay is not None and not 0.0 <= delay <= MAX_DELAY:
        raise ValueError(f"delay = {delay!r} ticks: expected 0 to {MAX_DELAY:g}")


WorldKind: TypeAlias = Wall | Springs | AnyWorld | SteppedTool | EulerTool | OtherDevice


@dataclass(frozen=True)
class WorldKMax:
    """Largest certified stiffness for one kind of world."""

    # nominal stiffness [N/m]; None: no stiffness is certified; infinite: every one is
    k_max_n_per_m: float | None
    low_n_per_m: float | None  # lower end of the window [N/m]
    frequency_hz: float | None  # where the upper end is reached [Hz]
    about: str  # which worlds and hands it is about


def region_of(plant: Plant, world: WorldKind, any_hand: bool) -> Region:
    """Return where device and world may lie; for `Springs` see `nodes.stability.spring_world`.

    Parameters
    ----------
    plant : Plant
        The device and its loop; with `any_hand` its mass and its hand do not matter.
    world : WorldKind
        The kind of world.
    any_hand : bool
        Whether every passive hand may hold the device; else the hand is that of the plant.
    """
    refuse_partner(plant)
    known, hands = (
        (None, (held_disc(plant, plant.damping, plant.delay),)) if any_hand else (plant, ())
    )
    if isinstance(world, AnyWorld):
        return Region(plant.period, known, hands, any_world=True)
    if isinstance(world, Wall):
        return Region(plant.period, known, hands)
    if isinstance(world, SteppedTool):
        late = plant.delay if world.delay is None else world.delay
        return Region(plant.period, known, (*hands, held_disc(plant, world.damping, late)))
    if isinstance(world, OtherDevice):
        return Region(plant.period, known, (*hands, held_disc(plant, world.damping, world.delay)))
    if isinstance(world, EulerTool):
        return Region(plant.period, known, (*hands, euler_disc(plant, world.mass)))
    raise ValueError("world: springs of a range are no region; use spring_window")


def refuse_partner(plant: Plant) -> None:
    """Refuse a plant with a partner: for a certificate that is a kind of world."""
    if plant.partner is not None:
        raise ValueError(
            "plant.partner: judge the device alone, and name the partner as its world: OtherDevice"
            " or SteppedTool"
        )


def held_disc(plant: Plant, damping: float, delay: float) -> Disc:
    """Return the disc of everything passive that a held force moves against a damper."""
    return Disc(0.5 * plant.period / damping, delay)


def euler_disc(plant: Plant, mass: float) -> Disc:
    """Return the disc of a mass that semi-implicit Euler moves once a tick, with anything implicit on it."""

    def radius(theta: Reals) -> Reals:
        return np.asarray(
            plant.period**2 / (4.0 * mass * np.sin(0.5 * theta) ** 2), dtype=np.float64
        )

    return Disc(radius, 0.0)


def world_k_max(
    derivative: CompiledLaw, plant: Plant, world: WorldKind, any_hand: bool = False
) -> WorldKMax:
    """Return the largest nominal stiffness that is certified for every world of a kind.

    Parameters
    ----------
    derivative : CompiledLaw
        The law without its spring (`nodes.stability.k_max.without_spring`).
    plant : Plant
        The device and its loop; its partner does not matter, the world takes its place. Without
        damping nothing but a wall or a spring is certified.
    world : WorldKind
        The kind of world.
    any_hand : bool
        Whether every passive hand may hold the device; else the hand is that of the plant.

    Returns
    -------
    WorldKMax
        The edge, and which worlds it is about.

    Raises
    ------
    ValueError
        For a law with code of its own, which has no transfer function; for springs with any hand.
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
        raise ValueError("world: springs are certified for a known device only; any hand: AnyWorld")
    if undamped(plant, world) and not isinstance(world, Springs):
        return none
    try:
        with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
            window = _window(derivative, plant, world, any_hand)
    except ArithmeticError:
        return none  # of a mass of 1e300 kg, say, nothing can be computed
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
        derivative, region_of(plant, world, any_hand), stable, wall_swings(derivative, plant)
    )


def is_stable(law: CompiledLaw, plant: Plant) -> bool:
    """Return whether the loop of a law and a device against a wall is stable."""
    return pole_radius(law, plant) < 1.0


def undamped(plant: Plant, world: WorldKind) -> bool:
    """Return whether device or tool lack the damping without which nothing is provable."""
    return plant.damping == 0.0 or (
        isinstance(world, SteppedTool | OtherDevice) and world.damping == 0.0
    )


def hand_text(plant: Plant, any_hand: bool) -> str:
    """Return which hands a certificate is about."""
    if any_hand:
        return (
            f"a device of at least {plant.damping:g} N s/m, its hand's share included, in any"
            " passive hand"
        )
    hand = f" and a hand of {plant.stiffness:g} N/m" if plant.stiffness else ""
    return f"the known device of {plant.mass:g} kg, {plant.damping:g} N s/m{hand}"


def certified(law: CompiledLaw, plant: Plant, world: WorldKind, any_hand: bool = False) -> bool:
    """Return whether a law as it is is certified for every world of a kind; parameters as of `world_k_max`."""
    plant = replace(plant, partner=None)
    if law.evaluate is not None:
        raise ValueError("law: has code of its own and no transfer function")
    if not (law.h1 > 0.0 and is_stable(law, plant)):
        return False
    if isinstance(world, Springs):
        return stable_with_springs(law, plant, world.softest, world.stiffest)
    if isinstance(world, Wall) and not any_hand:
        return True
    return not undamped(plant, world) and outside(law, region_of(plant, world, any_hand))
