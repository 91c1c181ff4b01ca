"""A launch of any axes in one process: the states and rules of the nodes themselves, tick by tick, as in lockstep.

It plays what nodes can: shapes, things that move, several axes, laws with code of their own and
swaps between them, all of the driver's safety. It is interpreted, for few runs (`sim.play.one_axis` is
for thousands); no rule in it is its own.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from messages.types import ZERO, Proxy, Vector
from nodes.base.setup import AXIS_INDEX
from nodes.coupling.law_book import LawBook
from nodes.coupling.parameters import CouplingParameters
from nodes.coupling.renderer import ActiveLaw, Renderer, settle_conventions
from nodes.environment.bodies.moving_scene import MovingScene
from nodes.environment.bodies.node import MujocoParameters, load_world
from nodes.environment.meet import Numbers, meeting_of
from nodes.environment.node import EnvironmentParameters
from nodes.environment.shapes.scene import Solid, new_memory, scene_table
from nodes.environment.state import SHAPES
from nodes.environment.surfaces import Meeting, Surface, meet_axes, parse_surface
from nodes.environment.touched_surface import TouchedSurface
from nodes.environment.world.node import FeltWorld, WorldParameters, check_world
from nodes.launcher.launch_spec import Launch
from nodes.launcher.plants import known_peak
from nodes.parameters.store import ParameterError
from sim.arrays import Array
from sim.device.driver import SimDriverParameters, parts_of
from sim.device.state import read_axis, write_axis
from sim.play.driver_rules import DriverRules
from sim.play.launched import parameters_of
from sim.play.one_axis import MAX_TICKS


class SpatialTrace(NamedTuple):
    """What happened, one row a tick."""

    position: Array  # what the encoders read [m], shape (ticks, 3)
    proxy: Array  # where the proxy was [m], shape (ticks, 3)
    # outward normal of what was touched; zero for a body that moves, shape (ticks, 3)
    normal: Array
    contact: NDArray[np.bool_]  # whether something was touched, shape (ticks,)
    force: Array  # force handed to the device, after all limits [N], shape (ticks, 3)
    law: list[str]  # which law rendered


class _Coupling:
    """The coupling node's renderer with its schedule."""

    def __init__(self, launch: Launch) -> None:
        name, parameters = parameters_of(launch, "coupling", CouplingParameters)
        period = launch.run.period
        book = LawBook(name, period)
        self.renderer = renderer = Renderer(
            [AXIS_INDEX[axis] for axis in launch.run.axes], parameters.memory
        )
        renderer.state.ease_peak = known_peak(launch, name.rpartition("/")[0]) or 0.0
        settle_conventions(renderer.state, parameters, period)

        def law(name: str) -> ActiveLaw:
            return ActiveLaw(name, "", book.compile(parameters, name), renderer.histories)

        renderer.fallback = ActiveLaw(
            "fallback", "", parameters.fallback.compile(period), renderer.histories
        )
        renderer.law = law(parameters.law)
        scheduled = sorted(parameters.schedule, key=lambda swap: swap.at)
        self._schedule = [(round(swap.at / period), law(swap.law), swap.ramp) for swap in scheduled]

    def answer(self, proxy: Proxy) -> Vector:
        """Render the force of a tick."""
        renderer = self.renderer
        renderer.follow(proxy, proxy.seq - 1 if proxy.seq else -1)
        while self._schedule and self._schedule[0][0] <= proxy.seq:
            _, law, ramp = self._schedule.pop(0)
            law.warm_up(renderer.histories)
            renderer.swap(law, ramp)
        due = renderer.due()
        try:
            force = renderer.render(proxy)
        except Exception:
            if not renderer.watched:
                raise
            # A law of another package may raise anything; the node falls back, too.
            return renderer.fall_back(proxy, due)
        return force if math.isfinite(force[0] + force[1] + force[2]) else renderer.fall_back(proxy)


class _Jumps:
    """The latest jump that no motion made, as the environment counts it, and how far the force moves the proxy [m/N]."""

    def __init__(self) -> None:
        self.tick, self.compliance = 0, 0.0


# From a tick, the position [m] and the force handed over last [N] to proxy, normal, distance and
# contact.
Ask = Callable[[int, Vector, Vector], Meeting]
SurfaceChange = tuple[int, dict[str, Any]]  # the first tick on another surface, and its parameters


def _environment(
    launch: Launch,
    next_tick: bool,
    solids: Sequence[Solid] | None,
    world: MovingScene | None,
    jumps: _Jumps,
    changes: Sequence[SurfaceChange],
) -> Ask:
    """Make what the device meets: a surface, other solids in its place, or a scene in which things move."""
    period = launch.run.period
    kinds = {spec.kind for spec in launch.nodes.values()}
    if "world" in kinds:
        return _body(launch, float(next_tick), jumps)
    if "mujoco" not in kinds:
        name, environment = parameters_of(launch, "environment", EnvironmentParameters)
        surface = parse_surface(environment.surface, f"{name}.surface")
        meet_axes(surface, launch.run.axes, f"{name}.surface")
        if solids is not None:
            radius = getattr(surface, "tool_radius", 0.0)
            meet = meeting_of(
                Numbers(SHAPES, scene_table(solids, radius, period), new_memory(len(solids)))
            )
            return lambda _, position, __: meet(position)
        return _surfaces(surface, launch, jumps, sorted(changes, key=lambda change: change[0]))
    name, bodies = parameters_of(launch, "mujoco", MujocoParameters)
    scene = load_world(bodies, period, name) if world is None else world
    delay = float(next_tick)

    def ask(tick: int, position: Vector, force: Vector) -> Meeting:
        if scene.follow(tick, position, force, tick - 1, delay, tick == 0):
            jumps.tick = tick
        return scene.tool_position, ZERO, 0.0, True

    return ask


def _body(launch: Launch, delay: float, jumps: _Jumps) -> Ask:
    """Make a world of one body."""
    name, parameters = parameters_of(launch, "world", WorldParameters)
    check_world(parameters, launch.run.period, name)
    world = FeltWorld(parameters, launch.run.period, launch.run.axes)

    def ask(tick: int, position: Vector, force: Vector) -> Meeting:
        at = world.follow(tick, position, force, tick - 1, delay)
        jumps.compliance = at.compliance
        return at.proxy, ZERO, 0.0, True

    return ask


def _surfaces(surface: Surface, launch: Launch, jumps: _Jumps, changes: list[SurfaceChange]) -> Ask:
    """Meet a surface, and others from some tick on, as the environment node changes them."""
    period, changes = launch.run.period, list(changes)
    place = TouchedSurface(surface, period)

    def ask(tick: int, position: Vector, _: Vector) -> Meeting:
        while changes and changes[0][0] <= tick:
            parameters = changes.pop(0)[1]
            if place.take(TouchedSurface(parse_surface(parameters, "surface"), period)):
                jumps.tick = tick
        met = place.meet(position)
        if place.jumped:
            jumps.tick = tick
        return met

    return ask


def play(
    launch: Launch,
    ticks: int | None = None,
    solids: Sequence[Solid] | None = None,
    path: Array | None = None,
    world: MovingScene | None = None,
    changes: Sequence[SurfaceChange] = (),
) -> SpatialTrace:
    """Play a launch file of one chain and virtual devices: the bits of a run in lockstep.

    `path`, shape (at least ticks, 3): where the encoders find the device [m], whatever the force;
    no device is played then. `changes` are other surfaces, each from a tick on. `solids` and
    `world` take the place of the launch file's own. ParameterError says what is wrong, as a launch
    would.
    """
    run = launch.run
    period, ticks = run.period, ticks or run.ticks or round(10.0 / run.period)
    if ticks > MAX_TICKS:
        raise ParameterError(
            f"run.duration: {ticks} ticks, limit {MAX_TICKS} in one process; launch a longer run"
        )
    _, driver = parameters_of(launch, "sim_driver", SimDriverParameters)
    next_tick = run.apply == "next_tick"
    jumps = _Jumps()
    meet = _environment(launch, next_tick, solids, world, jumps, changes)
    axes = [AXIS_INDEX[axis] for axis in run.axes]
    devices = parts_of(driver.device, run.axes, period, next_tick, driver.ends)
    parts = [device.state for device in devices]
    rules = DriverRules(driver.device, period, next_tick, driver.safety, driver.passivity, axes)
    coupling = _Coupling(launch)
    positions, proxies, normals, forces = (np.zeros((ticks, 3)) for _ in range(4))
    contacts, laws = np.zeros(ticks, dtype=np.bool_), []
    force = ZERO
    for k in range(ticks):
        if path is None:
            place = [0.0, 0.0, 0.0]
            for part in parts:
                place[part.axis] = read_axis(part, k)
        else:
            place = path[k].tolist()
        position = rules.sample(k, (place[0], place[1], place[2]))
        proxy, normal, distance, contact = meet(k, position, force)
        met: dict[str, Any] = {
            "proxy": proxy,
            "normal": normal,
            "distance": distance,
            "contact": contact,
        }
        met |= {"rebased": jumps.tick, "compliance": jumps.compliance}
        wanted = coupling.answer(Proxy(seq=k, stamp=k * period, position=position, **met))
        force = rules.command(k, wanted, normal if contact else ZERO)
        for part in parts:
            write_axis(part, force[part.axis], k, 0.0)
        positions[k], proxies[k], normals[k], contacts[k], forces[k] = (
            position,
            proxy,
            normal,
            contact,
            force,
        )
        laws.append(coupling.renderer.name)
    return SpatialTrace(positions, proxies, normals, contacts, forces, laws)
