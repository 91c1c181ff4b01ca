"""Guide a device along a path over shapes, with the compiled proxy of the environment."""

import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

# Registers the geometry with numba.
import nodes.environment.shapes.compiled_geometry as _registered
from nodes.environment.shapes import proxy
from nodes.environment.shapes.scene import FeltRegion, Solid, new_memory, scene_table
from nodes.environment.shapes.tables import (
    DISTANCE,
    FELT_AS,
    IN_CONTACT,
    NORMAL,
    NOW,
    PROXY,
    ROUNDS,
)
from sim.arrays import Array
from sim.play.compiled import compiled

del _registered


# `nodes.environment.shapes.proxy.meet`, compiled.
meet: Callable[[Any, Any, float, float, float], None] = compiled()(proxy.meet)
_ANSWER = 11


@compiled()
def _walk(scene: Array, memory: Array, path: Array, answers: Array) -> None:
    for i in range(len(path)):
        memory[NOW] = float(i)
        meet(scene, memory, path[i, 0], path[i, 1], path[i, 2])
        for k in range(3):
            answers[i, k] = memory[PROXY + k]
            answers[i, 3 + k] = memory[NORMAL + k]
        answers[i, 6], answers[i, 7], answers[i, 8] = (
            memory[DISTANCE],
            memory[IN_CONTACT],
            memory[ROUNDS],
        )
        answers[i, 9], answers[i, 10] = memory[FELT_AS], memory[FELT_AS + 1]


class Touched(NamedTuple):
    """Result of a guided path, one row per tick."""

    path: Array  # device positions [m], shape (ticks, 3)
    proxy: Array  # proxy positions [m], shape (ticks, 3)
    normal: Array  # outward normal, shape (ticks, 3)
    distance: Array  # signed distance along the normal [m], shape (ticks,)
    contact: NDArray[np.bool_]  # whether a shape is touched, shape (ticks,)
    rounds: Array  # iterations of each call, shape (ticks,)
    memory: Array  # state of the proxy at the end
    factors: Array  # of the law's stiffness and damping, shape (ticks, 2)


def touch(
    solids: Sequence[Solid],
    path: Array,
    tool_radius: float = 0.0,
    period: float = 1e-3,
    interpreted: bool = False,
    regions: Sequence[FeltRegion] = (),
) -> Touched:
    """Guide a device along a path (ticks, 3) [m] over shapes and through regions."""
    table = scene_table(solids, tool_radius, period, regions)
    answers = np.zeros((len(path), _ANSWER))
    if interpreted:
        kept: Any = new_memory(len(solids))
        for i, (answer, (x, y, z)) in enumerate(
            zip(answers, path.tolist(), strict=True)
        ):
            kept[NOW] = float(i)
            proxy.meet(table, kept, x, y, z)
            of_law = kept[FELT_AS : FELT_AS + 2]
            answer[:] = [*kept[PROXY : PROXY + 8], kept[ROUNDS], *of_law]
        memory = np.array(kept)
    else:
        memory = np.array(new_memory(len(solids)))
        _walk(
            np.array(table),
            memory,
            np.ascontiguousarray(path, dtype=np.float64),
            answers,
        )
    return Touched(
        path,
        answers[:, :3],
        answers[:, 3:6],
        answers[:, 6],
        answers[:, 7] == 1.0,
        answers[:, 8],
        memory,
        answers[:, 9:],
    )


def call_times(
    solids: Sequence[Solid],
    path: Array,
    tool_radius: float = 0.0,
    period: float = 1e-3,
    most: int = 20_000,
    regions: Sequence[FeltRegion] = (),
) -> Array:
    """Time single calls of the compiled proxy along a path [s].

    Each includes the interpreter's overhead of under 1 µs.
    """
    table = np.array(scene_table(solids, tool_radius, period, regions))
    memory = np.array(new_memory(len(solids)))
    times = []
    for i, (x, y, z) in enumerate(path[:most].tolist()):
        memory[NOW] = float(i)
        begin = time.perf_counter_ns()
        meet(table, memory, x, y, z)
        times.append(time.perf_counter_ns() - begin)
    return np.array(times, dtype=np.float64) * 1e-9
