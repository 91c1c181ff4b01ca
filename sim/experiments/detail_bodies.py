"""Level of detail of things that move, one path through all: dynamic, led as they went (kinematic), held (fixed), untouched."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from messages.types import Vector
from nodes.environment.bodies.moving_scene import MovingScene
from nodes.environment.bodies.node import MujocoParameters
from nodes.launcher.launch_spec import Launch
from sim.arrays import Array
from sim.experiments.detail import Detail, Level
from sim.scene.from_launch import parameters_of
from sim.scene.spatial import SpatialTrace, play

_HEAVY = 1e6
"""Mass of a body that is led, over what it has: nothing that touches it moves it."""


class _Watched(MovingScene):
    """A scene whose ticks are timed, and whose bodies are noted at every step."""

    def __init__(self, launch: Launch, held: bool = False) -> None:
        name, given = parameters_of(launch, "mujoco", MujocoParameters)
        super().__init__(Path(given.scene).expanduser(), given.tool, launch.run.period, name, held)
        self.times: list[int] = []
        self.went: list[tuple[Array, Array]] = []

    def follow(self, tick: int, position: Vector, force: Vector, since: int, delay: float, first: bool) -> bool:
        """Take the scene to a tick."""
        begin = time.perf_counter_ns()
        diverged = super().follow(tick, position, force, since, delay, first)
        self.times.append(time.perf_counter_ns() - begin)
        return diverged

    def step(self) -> None:
        """Go one step further."""
        self.went.append((self.data.qpos.copy(), self.data.qvel.copy()))
        super().step()


class _Led(_Watched):
    """A scene whose bodies go where they went in another, whatever pushes them."""

    def __init__(self, launch: Launch, went: list[tuple[Array, Array]]) -> None:
        super().__init__(launch)
        self._led = iter(went)
        others = self.model.body_rootid != self.tool
        self.model.body_mass[others] *= _HEAVY
        self.model.body_inertia[others] *= _HEAVY
        # What contacts are regularised by follows from the masses.
        self._mujoco.mj_setConst(self.model, self.data)
        places, speeds = np.ones(self.model.nq, dtype=bool), np.ones(self.model.nv, dtype=bool)
        places[self._slides] = False
        speeds[
            [int(self.model.jnt_dofadr[j]) for j in range(self.model.njnt) if self.model.jnt_qposadr[j] in self._slides]
        ] = False
        self._places, self._speeds = places, speeds

    def step(self) -> None:
        """Go one step further."""
        places, speeds = next(self._led)
        self.data.qpos[self._places], self.data.qvel[self._speeds] = places[self._places], speeds[self._speeds]
        super().step()


def body_detail(
    launch: Launch, stiffness: float, resolution: float, fraction: float, step: Callable[[str], None] = lambda _: None
) -> Detail:
    """Play the path of a run through all levels of detail of a scene in which things move.

    `stiffness`: H(1) of its law [N/m]. `fraction`: part of the largest force that counts as no difference. Returns: from
    dynamic bodies to none; of each its geoms and what a tick of the scene costs.
    """
    finest = _Watched(launch)
    path = play(launch, world=finest).position
    # Once more, with the path given as to all others.
    finest = _Watched(launch)
    ideal = play(launch, world=finest, path=path)
    largest = float(np.linalg.norm(ideal.force, axis=1).max())
    limit = max(stiffness * resolution, fraction * largest)
    levels = [_level("dynamic", finest, ideal, ideal, limit)]
    step("dynamic")
    coarser: list[tuple[str, Callable[[], _Watched]]] = [
        ("dynamic, without friction", lambda: _slippery(_Watched(launch))),
        ("kinematic: led as they went", lambda: _Led(launch, finest.went)),
        ("fixed", lambda: _Watched(launch, held=True)),
        ("a tool alone", lambda: _untouched(_Watched(launch, held=True))),
    ]
    for name, made in coarser:
        world = made()
        levels.append(_level(name, world, play(launch, world=world, path=path), ideal, limit))
        step(name)
    return Detail(tuple(levels), limit, stiffness * resolution, largest, ())


def _slippery(world: _Watched) -> _Watched:
    world.model.geom_friction[:] = 0.0
    world.model.dof_frictionloss[:] = 0.0
    return world


def _untouched(world: _Watched) -> _Watched:
    world.model.geom_contype[:] = world.model.geom_conaffinity[:] = 0
    return world


def _level(name: str, world: _Watched, found: SpatialTrace, ideal: SpatialTrace, limit: float) -> Level:
    difference = np.linalg.norm(found.force - ideal.force, axis=1)
    away = np.linalg.norm(found.proxy - ideal.proxy, axis=1)
    times = np.array(world.times, dtype=np.float64) / 1e3
    return Level.measured(name, int(world.model.ngeom), 0, difference, difference, away, times, limit)
