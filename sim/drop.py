"""The drop test, and the largest stiffness that still settles in it: K_max as the seed found it, by simulation.

Three experiments: *drop* (a mass falls on a virtual floor, the seed's), *press* (a hand pushes the device into a wall) and
*free* (the device swings about a two-sided anchor, which is the linear loop itself). A run settles when, over the last
quarter of a stated horizon, it moves less than a stated tolerance about the point where the forces balance, without
leaving the wall or touching a limit of the force; and when it has at no time risen above where it started. So
runs that diverged until something saturated are refused. Near the limit the decay is slow: the same horizon for every law,
or the figures do not compare (drop and press read 70–99 % of the linear limit).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np

from nodes.laws import CompiledLaw
from sim.compiled import compiled, kernel
from sim.loop import Array, Scene, Surface, play_compiled, run
from sim.plant import DeviceModel, Hand, coefficients, split_delay

LawOfStiffness = Callable[[float], CompiledLaw]


@dataclass(frozen=True)
class Criterion:
    """When a run counts as settled.

    Attributes
    ----------
    ticks : int
        Horizon [ticks].
    tolerance : float
        Largest motion, peak to peak, over the last quarter of the horizon [m].
    """

    ticks: int = 2500
    tolerance: float = 1e-4

    def __post_init__(self) -> None:
        if self.ticks < 8:
            raise ValueError(f"criterion.ticks is {self.ticks}, expected at least 8: a quarter must be two ticks")
        if not self.tolerance > 0.0:
            raise ValueError(f"criterion.tolerance is {self.tolerance} m, expected more than 0")


@dataclass(frozen=True)
class SimulatedKMax:
    """Where raising the nominal stiffness stops a run from settling.

    Attributes
    ----------
    k_max_n_per_m : float or None
        Largest K that settled, of the lowest interval that does [N/m]; None when none did, infinite when all above it did.
    h1_max_n_per_m : float or None
        H(1) there [N/m].
    unsettled_n_per_m : float or None
        Smallest K above it that did not [N/m].
    frequency_hz : float or None
        Frequency of the last swings seen at K_max [Hz]; None when it did not swing.
    ticks : int
        Simulated ticks.
    """

    k_max_n_per_m: float | None
    h1_max_n_per_m: float | None
    unsettled_n_per_m: float | None
    frequency_hz: float | None
    ticks: int


class SearchInterrupted(KeyboardInterrupt):
    """Ctrl-C during a search.

    Parameters
    ----------
    found : list of SimulatedKMax
        What was done until then, in the order of the laws.

    Attributes
    ----------
    found : list of SimulatedKMax
        The same.
    """

    def __init__(self, found: list[SimulatedKMax]) -> None:
        super().__init__()
        self.found = found


def drop_scene(device: DeviceModel, period: float, raw: bool, clamp: bool, height: float = 0.01) -> Scene:
    """Let the device fall on a floor at 0.

    Parameters
    ----------
    device : DeviceModel
        Its position, velocity and gravity are set here, to `height`, 0 and, where it has none, 9.81 m/s².
    period : float
        Sampling period T [s].
    raw : bool
        Whether the history holds the raw distance outside contact.
    clamp : bool
        Whether forces into the floor are set to zero.
    height : float
        Of the fall [m]; the project's floor drop has 10 mm.

    Returns
    -------
    Scene
        The experiment.
    """
    gravity = 9.81 if device.gravity is None else device.gravity
    dropped = _changed(device, position=height, velocity=0.0, gravity=gravity)
    return Scene(device=dropped, surface=Surface("plane"), period=period, raw=raw, clamp=clamp)


def press_scene(
    device: DeviceModel, period: float, raw: bool, clamp: bool, hand: Hand | None = None, depth: float = 0.01
) -> Scene:
    """Let a hand press the device into a wall at 0.

    Parameters
    ----------
    device : DeviceModel
        It starts at rest, `depth` before the wall.
    period : float
        Sampling period T [s].
    raw, clamp : bool
        As for `drop_scene`.
    hand : Hand, optional
        Held still at its own path; left out, a light grip of 100 N/m that wants to be `depth` behind the wall.
    depth : float
        Of start and aim, before and behind the wall [m].

    Returns
    -------
    Scene
        The experiment.
    """
    hand = Hand(stiffness=100.0, path=[(0.0, -depth)]) if hand is None else hand
    pressed = _changed(device, position=depth, velocity=0.0, hand=hand)
    return Scene(device=pressed, surface=Surface("plane"), period=period, raw=raw, clamp=clamp)


def free_scene(device: DeviceModel, period: float, amplitude: float = 0.01) -> Scene:
    """Let the device swing about an anchor at 0, from rest at an amplitude: no contact, no conventions.

    Parameters
    ----------
    device : DeviceModel
        Its position and velocity are set here.
    period : float
        Sampling period T [s].
    amplitude : float
        Where it starts [m].

    Returns
    -------
    Scene
        The experiment.
    """
    swung = _changed(device, position=amplitude, velocity=0.0)
    return Scene(device=swung, surface=Surface("anchor"), period=period, raw=True, clamp=False)


def _changed(device: DeviceModel, **fields: Any) -> DeviceModel:
    return DeviceModel(**{name: getattr(device, name) for name in device.__struct_fields__} | fields)


@kernel
def _row(table: Any, p: int) -> Any:
    if table is None:
        return None
    return table[p]


@kernel
def _judge(positions: Any, forces: Any, surface: float, normal: float) -> Any:
    """Furthest from the surface after the first touch; in the last quarter: the same, motion, mean, largest force."""
    ticks = len(positions)
    quarter = ticks - ticks // 4
    highest = -math.inf
    touched = normal == 0.0
    for k in range(ticks):
        distance = abs(positions[k] - surface) if normal == 0.0 else (positions[k] - surface) * normal
        touched = touched or distance < 0.0
        if touched and not distance <= highest:
            highest = distance
    low = math.inf
    high = -math.inf
    total = 0.0
    last = -math.inf
    strongest = 0.0
    for k in range(quarter, ticks):
        low = min(low, positions[k])
        high = max(high, positions[k])
        total += positions[k]
        last = max(last, (positions[k] - surface) * normal)
        strongest = max(strongest, abs(forces[k]))
    return highest, high - low, total / (ticks - quarter), last, strongest


def _trials(
    ticks: int,
    x: float,
    v: float,
    mass: float,
    damping: float,
    grip: float,
    early: float,
    early_map: Any,
    late: float,
    late_map: Any,
    resolution: float | None,
    friction: float | None,
    motor: float | None,
    load: float,
    loads: Any,
    waiting: int,
    kind: int,
    surface: float,
    normal: float,
    raw: bool,
    clamp: bool,
    peak: float | None,
    slew: float | None,
    taps: Any,
    recursive: Any,
    results: Any,
) -> None:
    count, length = taps.shape
    width = 0 if recursive is None else recursive.shape[1]
    for p in numba.prange(count):
        own = _row(recursive, p)
        positions = np.empty(ticks)
        forces = np.empty(ticks)
        bounds = np.array([0, length])
        states = np.array([0, width // 2])
        none = np.empty(0, dtype=np.int64)
        play_compiled(
            ticks,
            x,
            v,
            mass,
            damping,
            grip,
            early,
            early_map,
            late,
            late_map,
            resolution,
            friction,
            motor,
            load,
            loads,
            np.zeros(waiting),
            kind,
            surface,
            normal,
            raw,
            clamp,
            peak,
            slew,
            taps[p],
            bounds,
            own,
            np.zeros(width // 2),
            states,
            none,
            none,
            np.zeros(2 * max(length, 2)),
            positions,
            None,
            None,
            None,
            forces,
        )
        verdict = _judge(positions, forces, surface, normal)
        for i in range(5):
            results[p, i] = verdict[i]


_trials_compiled = compiled(parallel=True)(_trials)


def rest_position(scene: Scene, law: CompiledLaw, ticks: int) -> float | None:
    """Where the forces balance at the end of a run.

    Parameters
    ----------
    scene : Scene
        The experiment.
    law : CompiledLaw
        Its law.
    ticks : int
        When: a hand's path may go on until then [ticks].

    Returns
    -------
    float or None
        Position [m]; None when H(1) ≤ 0 or nothing holds the device.
    """
    load, grip = scene.device.load(ticks - 1, scene.period), scene.device.grip
    if law.h1 <= 0.0:
        return None
    if scene.surface.kind != "free":
        rest = (load + law.h1 * scene.surface.position) / (grip + law.h1)
        if scene.surface.kind == "anchor" or (rest - scene.surface.position) * scene.surface.normal <= 0.0:
            return rest
    return load / grip if grip > 0.0 else None


def settles(scene: Scene, laws: Sequence[CompiledLaw], criterion: Criterion) -> list[bool]:
    """Play one experiment with each of several laws, spread over the cores.

    Parameters
    ----------
    scene : Scene
        The experiment.
    laws : sequence of CompiledLaw
        Laws to try.
    criterion : Criterion
        What counts as settled.

    Returns
    -------
    list of bool
        Whether each settled.

    Raises
    ------
    ValueError
        When a law has code of its own, or the scene a passivity guard: `sim.loop.run` and the nodes play those.
    """
    for i, law in enumerate(laws):
        if law.evaluate is not None:
            raise ValueError(
                f"laws[{i}] has code of its own, which cannot be compiled: play it with the nodes, in lockstep"
            )
    if scene.passivity is not None and scene.passivity.guard == "on":
        raise ValueError("scene.passivity.guard is on: K_max is searched for the law alone; leave the guard out")
    device, surface = scene.device, scene.surface
    mass, damping, grip = device.moving_mass, device.moving_damping, device.grip
    whole, part = split_delay(device.delay + (1.0 if scene.next_tick else 0.0))
    early = part * scene.period
    late = scene.period - early
    ticks = criterion.ticks
    taps = np.zeros((len(laws), max(len(law.taps) for law in laws)))
    most = max(len(law.sections) for law in laws)
    recursive = np.zeros((len(laws), 4 * most))
    for i, law in enumerate(laws):
        taps[i, : len(law.taps)] = law.taps
        recursive[i, : 4 * len(law.sections)] = [c for section in law.sections for c in section]
    results = np.empty((len(laws), 5))
    _trials_compiled(
        ticks,
        device.position,
        device.velocity,
        mass,
        damping,
        grip,
        early,
        coefficients(mass, damping, grip, early) if early > 0.0 else None,
        late,
        coefficients(mass, damping, grip, late),
        device.resolution,
        device.friction,
        device.peak_force,
        device.load(0, scene.period),
        np.array([device.load(k, scene.period) for k in range(ticks)]) if device.hand else None,
        whole + 2,
        surface.code,
        surface.position,
        surface.normal if surface.kind == "plane" else 0.0,
        scene.raw,
        scene.clamp,
        scene.peak,
        scene.slew,
        taps,
        recursive if most else None,
        results,
    )
    return [_verdict(scene, law, told, criterion) for law, told in zip(laws, results.tolist(), strict=True)]


def settled(scene: Scene, law: CompiledLaw, position: Array, force: Array, criterion: Criterion) -> bool:
    """Judge one run that was played elsewhere, by the very rules of `settles`.

    Parameters
    ----------
    scene : Scene
        The experiment.
    law : CompiledLaw
        Its law.
    position : ndarray, shape (ticks,)
        Position at each tick [m].
    force : ndarray, shape (ticks,)
        Force handed to the device at each tick [N].
    criterion : Criterion
        What counts as settled.

    Returns
    -------
    bool
        Whether it settled.

    Raises
    ------
    ValueError
        When the run is not as long as the horizon.
    """
    if not len(position) == len(force) == criterion.ticks:
        raise ValueError(f"{len(position)} positions and {len(force)} forces, the horizon is {criterion.ticks} ticks")
    normal = scene.surface.normal if scene.surface.kind == "plane" else 0.0
    return _verdict(scene, law, _judge(position, force, scene.surface.position, normal), criterion)


def _verdict(scene: Scene, law: CompiledLaw, told: Sequence[float], criterion: Criterion) -> bool:
    device, surface = scene.device, scene.surface
    highest, motion, mean, last, strongest = told
    rest = rest_position(scene, law, criterion.ticks)
    if rest is None:
        return False
    start = device.position - surface.position
    # About an anchor the damper sees the start as a jump, and may kick the device a few times as far: that is linear.
    highest_allowed = start * surface.normal + criterion.tolerance if surface.kind == "plane" else 10.0 * abs(start)
    limit = min(value for value in (device.peak_force, scene.peak, math.inf) if value is not None)
    # Friction holds it anywhere within f_c of balance; the encoder sees no less than a count.
    band = criterion.tolerance + (device.friction or 0.0) / (law.h1 + device.grip) + (device.resolution or 0.0)
    bounces = surface.kind == "plane" and last > (device.resolution or 0.0)
    # Comparisons with NaN are false: a run that overflowed does not settle.
    still = motion <= criterion.tolerance and abs(mean - rest) <= band
    return bool(still and highest <= highest_allowed and strongest < limit and not bounces)


def swing_frequency(position: Array, period: float, rest: float, smallest: float = 1e-7) -> float | None:
    """Frequency of the last swings about a point, by interpolated upward crossings.

    Parameters
    ----------
    position : ndarray, shape (ticks,)
        Positions at the ticks [m].
    period : float
        Sampling period T [s].
    rest : float
        The point [m].
    smallest : float
        Swings smaller than this do not count [m].

    Returns
    -------
    float or None
        Inverse of the median of the last 20 times between crossings [Hz]; None with less than three crossings.
    """
    y = position - rest
    up = np.flatnonzero((y[:-1] < 0.0) & (y[1:] >= 0.0))
    instants = [k + y[k] / (y[k] - y[k + 1]) for k in up.tolist()]
    gaps = []
    for i in range(len(up) - 1):
        if np.ptp(y[up[i] : up[i + 1] + 1]) > smallest:
            gaps.append(instants[i + 1] - instants[i])
    if len(gaps) < 2:
        return None
    return float(1.0 / (np.median(gaps[-20:]) * period))


def simulated_k_max(
    law_of_stiffness: LawOfStiffness,
    scene: Scene,
    criterion: Criterion | None = None,
    low: float | None = None,
    high: float | None = None,
    precision: float = 1e-3,
) -> SimulatedKMax:
    """Raise K until the run no longer settles, then bisect.

    Parameters
    ----------
    law_of_stiffness : callable
        From nominal K [N/m] to the law.
    scene : Scene
        The experiment, e.g. of `drop_scene`.
    criterion : Criterion, optional
        What counts as settled; 2500 ticks and 0.1 mm when left out.
    low, high : float, optional
        Range of K, raised in steps of 10 % [N/m]; from 10⁻³ to 4 times m/T² when left out. PD without delay ends at
        0.686 m/T², but long filters go beyond.
    precision : float
        Relative width of the bracket at the end.

    Returns
    -------
    SimulatedKMax
        The boundary.
    """
    return simulated_boundary([law_of_stiffness], scene, criterion, low, high, precision)[0]


def simulated_boundary(
    laws_of_stiffness: Sequence[LawOfStiffness],
    scene: Scene,
    criterion: Criterion | None = None,
    low: float | None = None,
    high: float | None = None,
    precision: float = 1e-3,
    step: Callable[[str, int], None] | None = None,
) -> list[SimulatedKMax]:
    """Find K_max of many laws, spread over the cores.

    Parameters
    ----------
    laws_of_stiffness : sequence of callable
        From nominal K [N/m] to a law, e.g. one for each gain B.
    scene : Scene
        The experiment.
    criterion : Criterion, optional
        What counts as settled.
    low, high : float, optional
        Range of K as for `simulated_k_max` [N/m].
    precision : float
        Relative width of the bracket at the end.
    step : callable, optional
        Told what has been done, and how many of the laws that was: `sim.stopwatch.Progress.step`.

    Returns
    -------
    list of SimulatedKMax
        In the order of the laws.

    Raises
    ------
    SearchInterrupted
        On Ctrl-C; it carries what was done.
    """
    criterion = Criterion() if criterion is None else criterion
    unit = scene.device.moving_mass / scene.period**2
    low = 1e-3 * unit if low is None else low
    high = 4.0 * unit if high is None else high
    found: list[SimulatedKMax] = []
    group = 4 * numba.get_num_threads()
    try:
        for i in range(0, len(laws_of_stiffness), group):
            done = _search(laws_of_stiffness[i : i + group], scene, criterion, low, high, precision)
            found += done
            if step is not None:
                step("K_max by simulation", len(done))
    except KeyboardInterrupt as interrupt:
        raise SearchInterrupted(found) from interrupt
    return found


def _search(
    laws: Sequence[LawOfStiffness], scene: Scene, criterion: Criterion, low: float, high: float, precision: float
) -> list[SimulatedKMax]:
    rungs = np.geomspace(low, high, 1 + math.ceil(math.log(high / low) / math.log(1.1))).tolist()
    good: list[float | None] = [None] * len(laws)
    bad: list[float | None] = [None] * len(laws)
    ticks = [0] * len(laws)
    # Eight rungs at a time: few enough to stop early, enough to keep the cores busy with few laws.
    for first in range(0, len(rungs), 8):
        going = [i for i in range(len(laws)) if bad[i] is None]
        tried = [(i, k) for i in going for k in rungs[first : first + 8]]
        if not tried:
            break
        for (i, k), settled in zip(tried, settles(scene, [laws[i](k) for i, k in tried], criterion), strict=True):
            ticks[i] += criterion.ticks
            if bad[i] is None and settled:
                good[i] = k
            elif bad[i] is None and good[i] is not None:
                bad[i] = k
    while True:
        tried = []
        for i, (below, above) in enumerate(zip(good, bad, strict=True)):
            if below is not None and above is not None and above - below > precision * below:
                tried.append((i, 0.5 * (below + above)))
        if not tried:
            break
        for (i, k), settled in zip(tried, settles(scene, [laws[i](k) for i, k in tried], criterion), strict=True):
            ticks[i] += criterion.ticks
            (good if settled else bad)[i] = k
    return [_result(laws[i], scene, criterion, good[i], bad[i], ticks[i]) for i in range(len(laws))]


def _result(
    law: LawOfStiffness, scene: Scene, criterion: Criterion, good: float | None, bad: float | None, ticks: int
) -> SimulatedKMax:
    if good is None:
        return SimulatedKMax(None, None, None, None, ticks)
    if bad is None:
        return SimulatedKMax(math.inf, math.inf, None, None, ticks)
    best = law(good)
    rest = rest_position(scene, best, criterion.ticks)
    frequency = None
    if rest is not None:
        frequency = swing_frequency(run(scene, best, criterion.ticks).position, scene.period, rest)
    return SimulatedKMax(good, best.h1, bad, frequency, ticks)
