"""Compare levels of detail of the bodies of a scene by the force along one path."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from nodes.launcher.launch_spec import Launch
from sim.arrays import Array
from sim.experiments.detail import HEAVY, Detail, Watched, level
from sim.play.chain import Instead
from sim.play.given import Given
from sim.play.player import play


class _Led(Watched):
    """A scene whose bodies follow a recorded motion, whatever pushes them."""

    def __init__(self, launch: Launch, went: list[tuple[Array, Array]]) -> None:
        super().__init__(launch)
        self._led = iter(went)
        others = self.model.body_rootid != self.tool
        self.model.body_mass[others] *= HEAVY
        self.model.body_inertia[others] *= HEAVY
        # Contact regularisation depends on the masses.
        self._mujoco.mj_setConst(self.model, self.data)
        places: Any = np.ones(self.model.nq, dtype=bool)
        speeds: Any = np.ones(self.model.nv, dtype=bool)
        places[self._slides] = False
        speeds[
            [
                int(self.model.jnt_dofadr[j])
                for j in range(self.model.njnt)
                if self.model.jnt_qposadr[j] in self._slides
            ]
        ] = False
        self._places, self._speeds = places, speeds

    def step(self) -> None:
        """Advance by one step."""
        places, speeds = next(self._led)
        self.data.qpos[self._places], self.data.qvel[self._speeds] = (
            places[self._places],
            speeds[self._speeds],
        )
        super().step()


def body_detail(
    launch: Launch,
    stiffness: float,
    resolution: float,
    fraction: float,
    step: Callable[[str], None] = lambda _: None,
) -> Detail:
    """Play the path of a run through all levels of a moving scene, dynamic to static."""
    finest = Watched(launch)
    path = play(launch, instead=Instead(world=finest)).measured
    # Played again, with the path prescribed as for all other levels.
    finest = Watched(launch)
    ideal = play(launch, instead=Instead(world=finest), given=Given(path=path))
    largest = float(np.linalg.norm(ideal.force, axis=1).max())
    limit = max(stiffness * resolution, fraction * largest)
    levels = [level("dynamic", finest, ideal, ideal, limit)]
    step("dynamic")
    coarser: list[tuple[str, Callable[[], Watched]]] = [
        ("dynamic, without friction", lambda: _frictionless(Watched(launch))),
        ("kinematic: led as they went", lambda: _Led(launch, finest.went)),
        ("fixed", lambda: Watched(launch, held=True)),
        ("a tool alone", lambda: _untouched(Watched(launch, held=True))),
    ]
    for name, made in coarser:
        world = made()
        found = play(launch, instead=Instead(world=world), given=Given(path=path))
        levels.append(level(name, world, found, ideal, limit))
        step(name)
    return Detail(tuple(levels), limit, stiffness * resolution, largest, ())


def _frictionless(world: Watched) -> Watched:
    world.model.geom_friction[:] = 0.0
    world.model.dof_frictionloss[:] = 0.0
    return world


def _untouched(world: Watched) -> Watched:
    world.model.geom_contype[:] = world.model.geom_conaffinity[:] = 0
    return world
