"""The scene in one process: device, environment, coupling and driver in one loop.

It predicts the distributed loop, thousands of times faster. `play` is one function: it runs
interpreted (slow, for the test that compares both) or compiled, over the very kernels that the
nodes call.
"""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np

from nodes.driver.passivity import PassivityParameters, line_of
from nodes.environment.state import ANCHOR, FREE, PLANE
from nodes.laws import CompiledLaw
from sim.arrays import Array
from sim.device.model import DeviceModel, coefficients, ends_of, split_delay
from sim.play.compiled import numbers_of
from sim.play.given import Given
from sim.play.one_axis_loop import play, play_compiled
from sim.play.one_axis_tables import (
    Arrivals,
    Contact,
    Guard,
    LawTables,
    Motion,
    Records,
)

MAX_TICKS: Final = (
    10_000_000  # longest run of one process, which stores some 100 bytes per tick
)


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
    next_tick: bool = (
        False  # whether forces take effect one tick later (``apply: next_tick``)
    )
    passivity: PassivityParameters | None = (
        None  # the driver's passivity guard; None for none
    )
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


@dataclass(frozen=True)
class PlannedSwap:
    """A change of the law between two ticks."""

    tick: int  # first tick at which the new law acts
    law: CompiledLaw  # the new law
    # Length of the cross-fade [ticks], 0 for none: force (1−w)·old + w·new, w = (j+1)/ramp at the
    # j-th tick after the swap. A swap during a cross-fade starts from the law being faded in.
    ramp: int = 0


@dataclass(frozen=True)
class Trace:
    """Record of a run, one value per tick."""

    period: float  # sampling period [s]
    position: Array  # true position when sampled [m], shape (ticks,)
    velocity: Array  # true velocity when sampled [m/s], shape (ticks,)
    measured: Array  # encoder reading [m], shape (ticks,)
    deflection: Array  # deflection of the coupling [m], shape (ticks,)
    # Force passed to the device, after the driver's limits [N], shape (ticks,). Delay and
    # saturation of the device come after it.
    force: Array
    final: tuple[
        float, float
    ]  # position [m] and velocity [m/s] after the last tick, shape (2,)

    @property
    def time(self) -> Array:
        """Sampling instants [s]."""
        return np.arange(len(self.position), dtype=np.float64) * np.float64(self.period)


def run(
    scene: Scene,
    law: CompiledLaw,
    ticks: int,
    swaps: Sequence[PlannedSwap] = (),
    memory: int = 0,
    interpreted: bool = False,
    given: Given | None = None,
) -> Trace:
    """Play a scene from rest: no force and a constant deflection before tick 0.

    Parameters
    ----------
    scene : Scene
        Device, surface, period and conventions.
    law : CompiledLaw
        Law of tick 0.
    ticks : int
        Length of the run.
    swaps : sequence of PlannedSwap
        Later laws, in the order of their ticks.
    memory : int
        Least length of the history [ticks], over which swapped-in recursive laws are warmed up.
    interpreted : bool
        Run without compiling, thousands of times slower. A law with code of its own always runs
        interpreted, and so does a driver that does more than lower forces.
    given : Given, optional
        Additional inputs.

    Returns
    -------
    Trace
        Every tick.

    Raises
    ------
    ValueError
        For impossible ticks, swaps or laws.
    """
    return run_with_asked(scene, law, ticks, swaps, memory, interpreted, given)[0]


def _check(law: CompiledLaw, ticks: int, swaps: Sequence[PlannedSwap]) -> None:
    if ticks < 1:
        raise ValueError(f"ticks is {ticks}, expected at least 1")
    if ticks > MAX_TICKS:
        raise ValueError(
            f"ticks is {ticks}, expected at most {MAX_TICKS}: one process keeps all of a run;"
            " launch a longer one"
        )
    for i, swap in enumerate(swaps):
        earliest = swaps[i - 1].tick if i else 0
        if swap.tick < earliest:
            raise ValueError(
                f"swaps[{i}].tick is {swap.tick}, expected at least {earliest}: swaps come in order"
            )
        if swap.ramp < 0:
            raise ValueError(
                f"swaps[{i}].ramp is {swap.ramp}, expected 0 or more ticks"
            )
    for i, candidate in enumerate([law, *(swap.law for swap in swaps)]):
        if not candidate.finite:
            raise ValueError(
                f"law {i} of the run has a coefficient that is not finite: taps {candidate.taps}"
            )
        if candidate.evaluate is not None and swaps:
            raise ValueError(
                f"law {i} of the run has code of its own, which one process cannot swap: use the"
                " nodes"
            )


def run_with_asked(
    scene: Scene,
    law: CompiledLaw,
    ticks: int,
    swaps: Sequence[PlannedSwap] = (),
    memory: int = 0,
    interpreted: bool = False,
    given: Given | None = None,
) -> tuple[Trace, Array]:
    """Play as `run` does; return the trace and the forces before the driver's limits [N].

    The forces are 0 in real time.
    """
    _check(law, ticks, swaps)
    given = given or Given()
    own = law.own_code()
    if own is not None:
        numbered = None if interpreted else numbers_of(own, ticks)
        interpreted = numbered is None
        own = own if numbered is None else numbered
    laws = [law, *(swap.law for swap in swaps)]
    recursive = any(candidate.sections for candidate in laws)
    ring = max(2, memory, *(len(candidate.taps) for candidate in laws))
    taps_from = list(
        itertools.accumulate((len(candidate.taps) for candidate in laws), initial=0)
    )
    states_from = list(
        itertools.accumulate(
            (2 * len(candidate.sections) for candidate in laws), initial=0
        )
    )

    def numbers(values: Any, kind: Any = np.float64) -> Any:
        return list(values) if interpreted else np.array(values, dtype=kind)

    motion = motion_of(scene, ticks, given)
    arrivals = None
    if given.arrivals is not None:
        when, answers, values = given.arrivals
        late = 1.0 if scene.next_tick else 0.0
        arrivals = Arrivals(
            numbers(np.asarray(when, dtype=np.float64).tolist()),
            numbers(np.asarray(answers).tolist(), np.int64),
            numbers(np.asarray(values, dtype=np.float64).tolist()),
            late + scene.device.delay,
            numbers([0.0] * ticks),
            numbers([0.0] * len(when)),
        )
    records = Records(*(numbers([0.0] * ticks) for _ in Records._fields))
    nudged = (
        np.zeros((ticks, 3))
        if given.nudged is None and given.read is not None
        else given.nudged
    )
    contact = contact_of(scene)
    if not interpreted:
        motion, contact = in_numbers(ticks, motion, contact, lockstep=arrivals is None)
    loop = play if interpreted else play_compiled
    final = loop(
        ticks,
        motion,
        contact,
        LawTables(
            numbers([tap for candidate in laws for tap in candidate.taps]),
            numbers(taps_from, np.int64),
            (
                numbers(
                    [c for candidate in laws for s in candidate.sections for c in s]
                )
                if recursive
                else None
            ),
            numbers(states_from, np.int64),
            numbers([swap.tick for swap in swaps], np.int64),
            numbers([swap.ramp for swap in swaps], np.int64),
        ),
        numbers([0.0] * states_from[-1]),
        numbers([0.0] * (2 * ring)),
        numbers([0.0] * motion.waiting),
        records,
        _guard_of(scene, numbers),
        own,
        arrivals,
        nudged,
        given.read,
    )
    position, velocity, measured, deflections, force, asked = (
        np.asarray(row, dtype=np.float64) for row in records
    )
    return Trace(
        scene.period, position, velocity, measured, deflections, force, final
    ), asked


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


def _guard_of(scene: Scene, numbers: Callable[[list[Any]], Any]) -> Guard | None:
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
