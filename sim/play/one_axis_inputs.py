"""Scenes of one axis, and the inputs of their loop: motion, laws, contact and guard."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from nodes.driver.passivity import PassivityParameters, line_of
from nodes.environment.state import ANCHOR, FREE, PLANE
from sim.device.model import DeviceModel, coefficients, ends_of, split_delay
from sim.play.given import Given
from sim.play.one_axis_tables import Contact, Guard, Motion


@dataclass(frozen=True)
class SceneSurface:
    """The surface that the device may touch, on its axis."""

    # Nothing; a one-sided plane; or an anchor, a two-sided spring to a point.
    kind: Literal["free", "plane", "anchor"]
    position: float = 0.0  # coordinate of the plane or the anchor [m]
    # +1 or −1: the free side of the plane. Unused otherwise.
    normal: float = 1.0

    def __post_init__(self) -> None:
        if self.kind not in ("free", "plane", "anchor"):
            raise ValueError(
                f"surface.kind is {self.kind!r}, expected free, plane or anchor"
            )
        if self.normal not in (1.0, -1.0):
            raise ValueError(
                f"surface.normal is {self.normal}, expected +1 or -1: on one axis a plane faces up"
                " or down"
            )

    @property
    def code(self) -> int:
        """Number of the kind, for `play`."""
        return {"free": FREE, "plane": PLANE, "anchor": ANCHOR}[self.kind]


@dataclass(frozen=True, kw_only=True)
class Scene:
    """A scene without its law."""

    device: DeviceModel  # the virtual device
    surface: SceneSurface  # the touched surface
    period: float  # sampling period T [s]
    raw: bool  # whether the history holds the raw distance outside contact (True) or zero (False)
    clamp: bool  # whether forces into the surface are set to zero
    peak: float | None = None  # driver's limit of the force [N]
    slew: float | None = None  # driver's limit of the change of force per tick [N]
    # Smallest and largest position, the end stops of the device [m], shape (2,), or None.
    workspace: tuple[float, float] | None = None
    # whether forces take effect one tick later (``apply: next_tick``)
    next_tick: bool = False
    # the driver's passivity guard; None for none
    passivity: PassivityParameters | None = None
    # Ticks over which the force of a scene that begins in contact rises (the coupling's `ease`); 0:
    # at once.
    ease: int = 0

    def __post_init__(self) -> None:
        if not self.period > 0.0:
            raise ValueError(f"period is {self.period} s, expected more than 0")
        if (
            self.workspace is not None
            and not self.workspace[0] <= self.device.position <= self.workspace[1]
        ):
            raise ValueError(
                f"device.position is {self.device.position} m, expected inside the workspace,"
                f" {self.workspace[0]} to {self.workspace[1]} m"
            )
        for name in ("peak", "slew"):
            value = getattr(self, name)
            if value is not None and not value >= 0.0:
                raise ValueError(
                    f"{name} is {value} N, expected 0 or more, or None for no limit"
                )


def motion_of(scene: Scene, ticks: int, given: Given | None = None) -> Motion:
    """Convert the device of a scene for the loop; its loads, if any, to a list."""
    device = scene.device
    if device.mass_by_position:
        raise ValueError(
            "device.mass_by_position: the loop of one axis has one mass; sim.play.player plays it,"
            " and so does a launch"
        )
    mass, damping, grip = device.moving_mass, device.moving_damping, device.grip
    whole, part = split_delay(device.delay + (1.0 if scene.next_tick else 0.0))
    early = part * scene.period
    late = scene.period - early
    given = given or Given()
    loads = None
    if given.target is not None:
        loads = [
            device.load(k, scene.period, target)
            for k, target in enumerate(given.target.tolist())
        ]
    elif device.hand or given.force is not None:
        loads = [device.load(k, scene.period) for k in range(ticks)]
    if loads is not None and given.force is not None:
        loads = [
            load + force
            for load, force in zip(loads, given.force.tolist(), strict=True)
        ]
    body = {
        "position": device.position,
        "velocity": device.velocity,
        "mass": mass,
        "damping": damping,
        "grip": grip,
    }
    return Motion(
        **body,
        early=early,
        early_map=coefficients(mass, damping, grip, early) if early > 0.0 else None,
        late=late,
        late_map=coefficients(mass, damping, grip, late),
        resolution=device.resolution,
        friction=device.friction,
        motor=device.peak_force,
        ends=None
        if scene.workspace is None
        else ends_of(scene.workspace, device.resolution),
        load=device.load(0, scene.period),
        loads=loads,
        waiting=whole + 2,
        period=scene.period,
    )


def in_numbers(
    ticks: int, motion: Motion, contact: Contact, lockstep: bool = True
) -> tuple[Motion, Contact]:
    """Replace None by neutral numbers, so that one compiled version plays all scenes.

    The numbers change no bit. None is a type of its own: each combination would be compiled, which
    takes one to three seconds of processor time.
    """
    peak, slew = (
        math.inf if limit is None else limit for limit in (contact.peak, contact.slew)
    )
    return motion._replace(
        early_map=motion.late_map if motion.early_map is None else motion.early_map,
        resolution=motion.resolution or 0.0,
        friction=motion.friction or 0.0,
        motor=math.inf if motion.motor is None else motion.motor,
        ends=(-math.inf, math.inf) if motion.ends is None else motion.ends,
        loads=(
            np.full(ticks, motion.load)
            if motion.loads is None
            else np.array(motion.loads, dtype=np.float64)
        ),
        # Not in real time: after an infinite force the remainder of a change of force would be
        # lost.
    ), contact._replace(peak=peak, slew=slew if lockstep else contact.slew)


def contact_of(scene: Scene) -> Contact:
    """Convert surface, conventions and limits of a scene for the loop."""
    surface = scene.surface
    normal = surface.normal if surface.kind == "plane" else 0.0
    return Contact(
        surface.code,
        surface.position,
        normal,
        scene.raw,
        scene.clamp,
        scene.peak,
        scene.slew,
        scene.ease,
    )


def guard_of(scene: Scene, numbers: Callable[[list[Any]], Any]) -> Guard | None:
    """Return the passivity guard of a scene as numbers; None without one."""
    if scene.passivity is None or scene.passivity.guard != "on":
        return None
    # Rounded like the driver's value, which comes from the device's latency in seconds.
    line, part = line_of(round(scene.device.delay, 9))
    late = 1.0 if scene.next_tick else 0.0
    damping = scene.passivity.damping / scene.period
    allowance = scene.passivity.allowance
    return Guard(
        damping, scene.passivity.stiffness, late, numbers(list(line)), part, allowance
    )
