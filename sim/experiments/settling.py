"""Whether a motion settles: the criterion of the drop test, for many laws at once."""

import functools
import math
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np

from nodes.compiled.kernels.sources import kernel
from nodes.laws import CompiledLaw
from nodes.laws.pd_windowed import WindowedDamper
from sim.arrays import Array
from sim.play.compiled import compiled
from sim.play.one_axis import run
from sim.play.one_axis_inputs import Scene, contact_of, in_numbers, motion_of
from sim.play.one_axis_loop import play_compiled
from sim.play.one_axis_tables import Contact, LawTables, Motion, Records

SHORTEST = 8  # horizon whose last quarter is two ticks [ticks]
# allowed distance of the mean force from the load at rest, relative, for a law with own code
BALANCE = 0.01


@dataclass(frozen=True)
class Criterion:
    """Settling criterion of a run."""

    ticks: int = 2500  # horizon [ticks]
    # largest motion, peak to peak, over the last quarter of the horizon [m]
    tolerance: float = 1e-4

    def __post_init__(self) -> None:
        if self.ticks < SHORTEST:
            raise ValueError(
                f"criterion.ticks is {self.ticks}, expected at least {SHORTEST}: a quarter must be"
                " two ticks"
            )
        if not self.tolerance > 0.0:
            raise ValueError(
                f"criterion.tolerance is {self.tolerance} m, expected more than 0"
            )


@kernel
def rises(distance: float, start: float, tolerance: float) -> bool:
    """Whether a device rises above its start after first contact; true for NaN."""
    return not distance <= start + tolerance


@kernel
def rests(
    motion: float, mean: float, rest: float, tolerance: float, band: float
) -> bool:
    """Whether the last quarter of a run rests within `band` of the force balance.

    False for NaN.
    """
    return motion <= tolerance and abs(mean - rest) <= band


@kernel
def _row(table: Any, p: int) -> Any:
    if table is None:
        return None
    return table[p]


@kernel
def _judge(positions: Any, forces: Any, surface: float, normal: float) -> Any:
    """Return the farthest point after contact and the statistics of the last quarter.

    These are motion, mean, farthest point, largest force and mean force.
    """
    ticks = len(positions)
    quarter = ticks - ticks // 4
    highest = -math.inf
    touched = normal == 0.0
    for k in range(ticks):
        distance = (
            abs(positions[k] - surface)
            if normal == 0.0
            else (positions[k] - surface) * normal
        )
        touched = touched or distance < 0.0
        if touched and not distance <= highest:
            highest = distance
    low = math.inf
    high = -math.inf
    total = 0.0
    last = -math.inf
    strongest = 0.0
    push = 0.0
    for k in range(quarter, ticks):
        low = min(low, positions[k])
        high = max(high, positions[k])
        total += positions[k]
        last = max(last, (positions[k] - surface) * normal)
        strongest = max(strongest, abs(forces[k]))
        push += forces[k]
    count = ticks - quarter
    return highest, high - low, total / count, last, strongest, push / count


def _trials(
    first: int,
    last: int,
    ticks: int,
    motion: Motion,
    contact: Contact,
    taps: Any,
    recursive: Any,
    windows: Any,
    results: Any,
) -> None:
    length = taps.shape[1]
    width = 0 if recursive is None else recursive.shape[1]
    for p in range(first, last):
        own = _row(recursive, p)
        positions = np.empty(ticks)
        forces = np.empty(ticks)
        none = np.empty(0, dtype=np.int64)
        laws = LawTables(
            taps[p], np.array([0, length]), own, np.array([0, width // 2]), none, none
        )
        states = np.zeros(width // 2)
        history = np.zeros(2 * max(length, 2))
        commands = np.zeros(motion.waiting)
        records = Records(positions, None, None, None, forces, None)
        play_compiled(
            ticks,
            motion,
            contact,
            laws,
            states,
            history,
            commands,
            records,
            None,
            _row(windows, p),
        )
        verdict = _judge(positions, forces, contact.surface, contact.normal)
        for i in range(6):
            results[p, i] = verdict[i]


_trials_compiled = compiled()(_trials)


def linear_at_rest(law: CompiledLaw) -> bool:
    """Whether a law renders H(1) at a constant deflection: no own code, or only a damper."""
    return law.evaluate is None or isinstance(law.evaluate, WindowedDamper)


def rest_position(scene: Scene, law: CompiledLaw, ticks: int) -> float | None:
    """Return where the forces of a linear law balance at the end of a run [m].

    None if H(1) ≤ 0 or nothing opposes the load.
    """
    load = scene.device.load(ticks - 1, scene.period)
    grip = scene.device.grip
    if law.h1 <= 0.0:
        return None
    if scene.surface.kind != "free":
        rest = (load + law.h1 * scene.surface.position) / (grip + law.h1)
        if (
            scene.surface.kind == "anchor"
            or (rest - scene.surface.position) * scene.surface.normal <= 0.0
        ):
            return rest
    return load / grip if grip > 0.0 else None


@functools.cache
def _threads(process: int) -> ThreadPoolExecutor:
    """Return a persistent thread pool for this process.

    A search plays tens of thousands of batches, and a forked process does not inherit threads.
    """
    del process
    return ThreadPoolExecutor(len(os.sched_getaffinity(0)), "drops")


def settles(
    scene: Scene, laws: Sequence[CompiledLaw], criterion: Criterion
) -> list[bool]:
    """Play one experiment with each of several laws, in parallel; return the verdicts.

    A scene with a passivity guard is refused; `run` plays it.
    """
    if scene.passivity is not None and scene.passivity.guard == "on":
        raise ValueError(
            "scene.passivity.guard is on: K_max is searched for the law alone; leave the guard out"
        )
    if not laws:
        return []
    own = [law.evaluate for law in laws]
    dampers = [one for one in own if isinstance(one, WindowedDamper)]
    if any(one is not None for one in own) and len(dampers) < len(laws):
        # Other own code is not compiled: the interpreter plays such laws one after
        # another.
        return [
            (
                _played(scene, law, criterion)
                if law.evaluate is not None
                and not isinstance(law.evaluate, WindowedDamper)
                else settles(scene, [law], criterion)[0]
            )
            for law in laws
        ]
    windows = (
        np.array([(one.gain, one.error, one.window) for one in dampers])
        if dampers
        else None
    )
    ticks = criterion.ticks
    taps = np.zeros((len(laws), max(len(law.taps) for law in laws)))
    most = max(len(law.sections) for law in laws)
    recursive = np.zeros((len(laws), 4 * most))
    for i, law in enumerate(laws):
        taps[i, : len(law.taps)] = law.taps
        recursive[i, : 4 * len(law.sections)] = [
            c for section in law.sections for c in section
        ]
    results = np.empty((len(laws), 6))
    found = motion_of(scene, ticks)
    contact = contact_of(scene)
    motion, contact = in_numbers(ticks, found, contact)
    # Few scenes have end stops, and checking them costs a twelfth of a tick.
    motion = motion._replace(ends=found.ends)
    # Handing over a few runs costs as much as playing them.
    cores = min(len(os.sched_getaffinity(0)), 1 + len(laws) // 8)
    bounds = [len(laws) * i // cores for i in range(cores + 1)]

    def play(part: int) -> None:
        sections = recursive if most else None
        _trials_compiled(
            bounds[part],
            bounds[part + 1],
            ticks,
            motion,
            contact,
            taps,
            sections,
            windows,
            results,
        )

    if cores == 1:
        play(0)
    else:
        # Compiled code releases the GIL, so that threads run in parallel.
        list(_threads(os.getpid()).map(play, range(cores)))
    return [
        _verdict(scene, law, end, criterion)
        for law, end in zip(laws, results.tolist(), strict=True)
    ]


def _played(scene: Scene, law: CompiledLaw, criterion: Criterion) -> bool:
    with np.errstate(all="ignore"):
        trace = run(scene, law, criterion.ticks)
    return settled(scene, law, trace.position, trace.force, criterion)


def settled(
    scene: Scene, law: CompiledLaw, position: Array, force: Array, criterion: Criterion
) -> bool:
    """Judge positions [m] and forces [N] of a run played elsewhere, by the rules of `settles`."""
    if not len(position) == len(force) == criterion.ticks:
        raise ValueError(
            f"{len(position)} positions and {len(force)} forces, the horizon is {criterion.ticks}"
            " ticks"
        )
    normal = scene.surface.normal if scene.surface.kind == "plane" else 0.0
    return _verdict(
        scene, law, _judge(position, force, scene.surface.position, normal), criterion
    )


def _verdict(
    scene: Scene, law: CompiledLaw, end: Sequence[float], criterion: Criterion
) -> bool:
    device, surface = scene.device, scene.surface
    highest, motion, mean, last, strongest, push = end
    # Friction can stop it anywhere within f_c of balance; the encoder resolves one count.
    friction = device.friction or 0.0
    if linear_at_rest(law):
        rest = rest_position(scene, law, criterion.ticks)
        if rest is None:
            return False
        band = (
            criterion.tolerance
            + friction / (law.h1 + device.grip)
            + (device.resolution or 0.0)
        )
        still = rests(motion, mean, rest, criterion.tolerance, band)
    else:
        # Such a law has no H(1) that predicts its rest position: check the balance of the
        # played forces.
        load = device.load(criterion.ticks - 1, scene.period) - device.grip * mean
        still = rests(
            motion, push, -load, criterion.tolerance, friction + BALANCE * abs(load)
        )
    start = device.position - surface.position
    if surface.kind == "plane":
        high = rises(highest, start * surface.normal, criterion.tolerance)
    else:
        # At an anchor the damper sees the start as a jump and may kick the device a few
        # times as far; this is linear behaviour.
        high = rises(highest, 10.0 * abs(start), 0.0)
    limit = min(
        value
        for value in (device.peak_force, scene.peak, math.inf)
        if value is not None
    )
    bounces = surface.kind == "plane" and last > (device.resolution or 0.0)
    return bool(still and not high and strongest < limit and not bounces)
