"""Least damping of device or tool, or mass of the tool, for a law's certificate."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from nodes.laws import CompiledLaw
from nodes.stability.dips import Reals, dips
from nodes.stability.effective_damping import damping_needed
from nodes.stability.judge import last_inside
from nodes.stability.k_window import outside
from nodes.stability.loop_region import Disc, Region
from nodes.stability.plant import Plant
from nodes.stability.worlds import (
    AnyWorld,
    Wall,
    WorldKind,
    certified,
    euler_disc,
    held_disc,
    is_stable,
    region_of,
)

_DECADES = range(-4, 5)
_LARGEST_FACTOR = 1e6
_HALVINGS = 34  # per decade: to 1e-10 of the value


def needed_device_damping(
    law: CompiledLaw, plant: Plant, world: WorldKind, any_hand: bool = False
) -> float | None:
    """Return the least device damping that certifies a law [N s/m]; None if none is enough.

    Parameters
    ----------
    law : CompiledLaw
        The law.
    plant : Plant
        The device and its loop; its damping is ignored.
    world : WorldKind
        The kind of world.
    any_hand : bool
        Whether every passive hand may hold the device. For a wall and for any world this is a
        closed form; else a bisection from the lowest decade that is certified, over eight decades
        about |H| T/2.
    """
    if any_hand and isinstance(world, Wall):
        return max(0.0, damping_needed(law, plant.period, plant.delay))
    if any_hand and isinstance(world, AnyWorld):
        return _for_any_hand_any_world(law, plant)
    unit = 0.5 * plant.period * max(abs(law.h1), abs(law.h_nyquist), 1e-9)

    def holds(damping: float) -> bool:
        return certified(law, replace(plant, damping=damping), world, any_hand)

    inside = next(
        (unit * 10.0**power for power in _DECADES if holds(unit * 10.0**power)), None
    )
    if inside is None:
        return None
    return last_inside(
        holds,
        inside,
        0.1 * inside if inside > unit * 10.0 ** _DECADES[0] else 0.0,
        _HALVINGS,
    )


def _for_any_hand_any_world(law: CompiledLaw, plant: Plant) -> float | None:
    """Return max (1 − Re ψ)/(2 Re{D/H}).

    It is a proof where Re{D/H} > 0 and H has no zero outside the unit circle.
    """
    region = Region(plant.period, None, (Disc(1.0, plant.delay),), any_world=True)

    def below(theta: Reals) -> Reals:
        # c of a region is room |H|² + Re{D'* H}: room = −(1 − Re ψ) for a radius of 1.
        room, _, whole = region.quadratic(law, theta)
        over = whole - room * np.abs(law.response(np.exp(1j * theta))) ** 2
        with np.errstate(divide="ignore", invalid="ignore"):
            needed = -room * np.abs(law.response(np.exp(1j * theta))) ** 2 / over
        return np.where(over > 0.0, -needed, -math.inf)

    theta = region.frequencies(law)
    values = below(theta)
    if np.isneginf(values).any():
        return None
    _, lowest = dips(below, theta, values)
    if np.isneginf(lowest).any():
        return None
    # The loop of a damped device belongs to the family; with this damping it must be stable.
    damping = 0.5 * plant.period * max(0.0, -float(lowest.min()))
    return (
        damping
        if is_stable(law, replace(plant, damping=damping * (1.0 + 1e-9)))
        else None
    )


def needed_tool_damping(
    law: CompiledLaw, plant: Plant, any_hand: bool = False, delay: float | None = None
) -> float | None:
    """Return the least damping to ground of a stepped tool that certifies a law [N s/m].

    None if none is enough, with anything passive attached to the tool.

    Parameters
    ----------
    law : CompiledLaw
        The law.
    plant : Plant
        The device and its loop.
    any_hand : bool
        Whether every passive hand may hold the device; else the hand is that of the plant.
    delay : float or None
        From the sample to the force that moves the tool [ticks]; None: as late as on the device.
    """
    unit = held_disc(plant, 1.0, plant.delay if delay is None else delay)
    return _least_tool(law, plant, any_hand, unit, plant.damping)


def needed_tool_mass(
    law: CompiledLaw,
    plant: Plant,
    any_hand: bool = False,
    steps: int = 1,
    delay: float = 0.0,
) -> float | None:
    """Return the least mass of a semi-implicit Euler tool that certifies a law [kg].

    None if none is enough, with implicit bodies behind the tool.

    Parameters
    ----------
    law : CompiledLaw
        The law.
    plant : Plant
        The device and its loop.
    any_hand : bool
        Whether every passive hand may hold the device; else the hand is that of the plant.
    steps : int
        Steps of the integrator in a tick, the force held.
    delay : float
        From the sample to the force that moves the tool, whole [ticks].
    """
    unit = euler_disc(plant, 1.0, steps, 0.0, delay)
    return _least_tool(law, plant, any_hand, unit, plant.mass)


def _least_tool(
    law: CompiledLaw, plant: Plant, any_hand: bool, unit: Disc, most: float
) -> float | None:
    """Return the least divisor of a unit tool's disc that leaves the law outside it.

    None above a million times `most`: a limit reached at ω → 0 is infinite.
    """
    region = region_of(plant, Wall(), any_hand)
    if plant.damping == 0.0 or not (
        law.h1 > 0.0 and is_stable(law, plant) and outside(law, region)
    ):
        return None
    theta = region.frequencies(law)

    def size(at: Reals) -> Reals:
        a, b, c = region.grown(law, unit, at)
        with np.errstate(divide="ignore", invalid="ignore"):
            largest = c / (np.sqrt(np.maximum(b * b - a * c, 0.0)) - b)
        return np.where(
            np.isfinite(largest) & (largest > 0.0), largest, math.inf
        ) / unit.radii(at)

    _, least = dips(size, theta, size(theta))
    if not least.size:
        return 0.0
    needed = 1.0 / float(least.min())
    return needed if needed < _LARGEST_FACTOR * most else None
