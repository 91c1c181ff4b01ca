"""The drop test of the paper and two further experiments, with their settling criterion.

*Drop* (the paper's): a mass falls on a virtual floor; *press*: a hand pushes the device into a
wall; *free*: the device swings about a two-sided anchor, i.e. the linear loop. A run settles if,
over the last quarter of a stated horizon, it moves less than a tolerance about the point of force
balance, stays in the wall, reaches no force limit, and has never risen above its start. Near the
limit the decay is slow, so every law must be judged over the same horizon (drop and press read
70–99 % of the linear limit).
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import msgspec
import numpy as np

from nodes.arithmetic import one_sided
from nodes.compiled.kernels.sources import kernel
from nodes.coupling.parameters import CouplingParameters
from nodes.coupling.render import evaluate
from nodes.environment.state import PLANE
from nodes.laws import CompiledLaw
from nodes.stability.plant import Plant
from sim.arrays import Array
from sim.device.hand import Hand
from sim.device.model import DeviceModel
from sim.experiments.settling import Criterion, settled
from sim.play.one_axis import Trace, run
from sim.play.one_axis_inputs import Scene, SceneSurface
from sim.play.one_axis_loop import respond

GRAVITY = 9.81  # default for a device without gravity [m/s²]
HEIGHT = 0.01  # default drop height [m]


class Convention(NamedTuple):
    """Contact convention: the law's input outside contact, and whether a wall may pull."""

    # whether the law gets the raw position (``history: position``) instead of the penetration
    raw: bool
    clamp: bool  # whether a force into the wall is clamped to zero


def coupling_convention() -> Convention:
    """Return the default convention of the coupling; every drop uses it by default."""
    usual = {
        field.name: field.default
        for field in msgspec.structs.fields(CouplingParameters)
    }
    return Convention(usual["history"] == "position", bool(usual["clamp"]))


CONVENTION = coupling_convention()


def held(plant: Plant) -> DeviceModel:
    """Return the virtual device of a linear plant, with the hand's spring fixed at 0."""
    hand = (
        Hand(stiffness=plant.stiffness, path=[(0.0, 0.0)])
        if plant.stiffness > 0.0
        else None
    )
    return DeviceModel(
        mass=plant.mass, damping=plant.damping, delay=plant.delay, hand=hand
    )


def _at_plane(device: DeviceModel, period: float, raw: bool, clamp: bool) -> Scene:
    """Return a device and a plane at 0."""
    plane = SceneSurface("plane")
    return Scene(device=device, surface=plane, period=period, raw=raw, clamp=clamp)


def drop_scene(
    device: DeviceModel,
    period: float,
    raw: bool = CONVENTION.raw,
    clamp: bool = CONVENTION.clamp,
    height: float = HEIGHT,
) -> Scene:
    """Return the drop of a device from a height [m] on a floor at 0.

    A device without gravity gets `GRAVITY`.
    """
    gravity = GRAVITY if device.gravity is None else device.gravity
    dropped = msgspec.structs.replace(
        device, position=height, velocity=0.0, gravity=gravity
    )
    return _at_plane(dropped, period, raw, clamp)


def press_scene(
    device: DeviceModel,
    period: float,
    raw: bool,
    clamp: bool,
    hand: Hand | None = None,
    depth: float = 0.01,
) -> Scene:
    """Return a hand pressing the device from before a wall at 0 to as far behind it [m].

    The default hand has 100 N/m.
    """
    hand = Hand(stiffness=100.0, path=[(0.0, -depth)]) if hand is None else hand
    pressed = msgspec.structs.replace(device, position=depth, velocity=0.0, hand=hand)
    return _at_plane(pressed, period, raw, clamp)


def free_scene(device: DeviceModel, period: float, amplitude: float = 0.01) -> Scene:
    """Return a swing about an anchor at 0, released at rest at `amplitude` [m]: no contact."""
    swung = msgspec.structs.replace(device, position=amplitude, velocity=0.0)
    return Scene(
        device=swung,
        surface=SceneSurface("anchor"),
        period=period,
        raw=True,
        clamp=False,
    )


@kernel
def floor_force(
    x: float,
    taps: Any,
    recursive: Any,
    memory: Any,
    history: Any,
    head: int,
    length: int,
    raw: bool,
    clamp: bool,
) -> tuple[int, float, bool]:
    """Return the history's new head, the force [N] on a floor at 0, and whether in contact.

    Every drop that `sim.play.one_axis_loop` does not play calls this; it runs the same kernels
    in the same order.
    """
    head, _, touches = respond(x, PLANE, 0.0, 1.0, raw, history, head, length)
    force = evaluate(taps, recursive, memory, history, head)
    return head, one_sided(force, 1.0, force, touches, raw, clamp), touches


def fall(
    move: Callable[[float], float],
    law: CompiledLaw,
    height: float,
    ticks: int,
    convention: Convention = CONVENTION,
) -> tuple[Array, Array]:
    """Drop a device known only by its step; return position [m] and force [N] at each tick.

    `move` applies a force [N] for one tick and returns the next position [m]. `dropped` plays
    the rigid device; this function is for other integrators and devices.
    """
    length = max(len(law.taps), 2)
    recursive = [number for section in law.sections for number in section]
    history = [0.0] * (2 * length)
    memory = [0.0] * (2 * len(law.sections))
    head = 0
    seen = np.empty((2, ticks))
    x = height
    for k in range(ticks):
        head, force, _ = floor_force(
            x, law.taps, recursive, memory, history, head, length, *convention
        )
        seen[:, k] = x, force
        x = move(force)
    return seen[0], seen[1]


class Dropped(NamedTuple):
    """Result of a drop."""

    trace: Trace  # its ticks
    settled: bool  # verdict of `settles`


def dropped(
    device: DeviceModel,
    law: CompiledLaw,
    period: float,
    ticks: int = Criterion.ticks,
    convention: Convention = CONVENTION,
    height: float = HEIGHT,
) -> Dropped:
    """Drop a device with a law and return every tick, with a launch's default settings."""
    scene = drop_scene(device, period, *convention, height)
    trace = run(scene, law, ticks)
    return Dropped(
        trace, settled(scene, law, trace.position, trace.force, Criterion(ticks))
    )
