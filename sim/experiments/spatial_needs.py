"""What a scene in several axes needs: every term switched, and force and proxy along the way compared.

A scene in one axis is for how it settles or how stiff it may get (`sim.experiments.needs`); one in three is for what is felt
along a way. So its outcome is the force and the proxy at every tick, beside the figures of all scenes.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from nodes.launcher.launch_spec import Launch
from sim.arrays import Array
from sim.experiments.needs import Needs, Outcome, Play, here, judge, movement, variants_of
from sim.experiments.spatial_terms import SPATIAL_CONVENTIONS, SPATIAL_TERMS, SpatialScene, spatial_scene
from sim.scene.spatial import SpatialTrace

_TAIL = 5


def spatial_outcome(trace: SpatialTrace, period: float) -> Outcome:
    """Work out what came of a run; lengths and forces in space."""
    tail = max(2, len(trace.position) // _TAIL)
    force, end = trace.force, trace.position[-tail:]
    travel = float(np.ptp(trace.position, axis=0).max())
    away = np.flatnonzero(~(np.linalg.norm(trace.position - end.mean(axis=0), axis=1) <= 0.01 * travel))
    return Outcome(
        settling_s=(int(away[-1]) + 1 if len(away) else 0) * period,
        peak_force_n=float(np.linalg.norm(force, axis=1).max()),
        rest_force_n=float(np.linalg.norm(force[-tail:].mean(axis=0))),
        travel_m=travel,
        limit_cycle_m=float(np.ptp(end, axis=0).max()),
        h1_max_n_per_m=None,
    )


def apart(before: Array, after: Array, scale: Array) -> float:
    """Root mean square of a difference over that of what it is measured by."""
    size = float(np.sqrt(np.mean(np.sum(scale**2, axis=1))))
    difference = float(np.sqrt(np.mean(np.sum((after - before) ** 2, axis=1))))
    if not np.isfinite(difference):
        return float("inf")
    return difference / size if size > 0.0 else 0.0 if difference == 0.0 else float("inf")


def _play(scene: SpatialScene) -> SpatialTrace:
    with np.errstate(all="ignore"):
        return scene.play()


def spatial_needs(
    launch: Launch,
    rounds: int = 5,
    step: Callable[[str], None] | None = None,
    players: Play[SpatialScene, SpatialTrace] = here,
) -> Needs:
    """Switch every term of a scene with several axes.

    `launch`: one chain with a virtual device, and shapes or bodies. `rounds`: interleaved rounds of timing; 0 times nothing.
    `players`: plays the variants; here, one after another, when left out. Returns: ``force`` is the root mean square of its
    difference over that of the force, ``proxy`` that of the proxy's difference over that of the deflection. Raises
    ParameterError when one process cannot play it, or it touches nothing.
    """
    scene, period = spatial_scene(launch), launch.run.period
    with np.errstate(all="ignore"):
        first = scene.play()
        before = spatial_outcome(first, period)
        variants = variants_of(scene, SPATIAL_TERMS, SPATIAL_CONVENTIONS, (("friction", "resolution"),))

        def changes(changed: SpatialScene, trace: SpatialTrace) -> dict[str, float]:
            del changed
            return movement(before, spatial_outcome(trace, period), period) | {
                "force": apart(first.force, trace.force, first.force),
                "proxy": apart(first.proxy, trace.proxy, first.proxy - first.position),
            }

        findings, tick = judge(
            scene, variants, _play, changes, len(first.position), launch.model, rounds, step, players
        )
    return Needs(before, findings, tick)
