"""K_max measured on the distributed loop: each drop is a ``haptic launch`` in lockstep.

The one-process study is only valid if the real loop renders the same. So each stiffness is also
dropped through all processes and judged by the study's criterion. Both must end at the same
stiffness of a common grid.
"""

import json
import math
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from messages.topics import DEVICE_STATE
from nodes.launcher import launch_file
from nodes.laws import CompiledLaw, Law
from nodes.laws.parse import law_to_dict
from nodes.recording.reader import Recording
from sim.arrays import Array
from sim.experiments.settling import Criterion, settled, settles
from sim.measure import measured_launch
from sim.measure.haptic_commands import MeasurementError
from sim.play.launched import LaunchedScene, from_launch
from sim.play.one_axis_inputs import Scene

SCENARIO = "floor_drop"  # launch file whose nodes get the experiment's parameters
# No force ramp either for a swing that begins with a force: nobody holds the device.
NO_LIMITS: dict[str, Any] = {
    "peak_force": None,
    "slew": None,
    "workspace": None,
    "ramp": 0.0,
    "without": ["peak_force", "slew", "workspace"],
}


@dataclass(frozen=True)
class SameKMax:
    """Stiffness at which launched and one-process drops stop settling, on one grid."""

    # Largest K of the grid below the first that the processes do not settle with [N/m]; None
    # if the first does not settle, infinite if the last does.
    launched_n_per_m: float | None
    one_process_n_per_m: float | None  # the same, played in one process [N/m]
    h1_n_per_m: float | None  # H(1) of the law at `launched_n_per_m` [N/m]
    launches: int  # number of launches


def with_stiffness(law: Law, stiffness: float) -> dict[str, Any]:
    """Return a law's parameters with another nominal stiffness [N/m]; refuse one without."""
    described = law_to_dict(law)
    if "stiffness" not in described:
        raise ValueError(
            f"law kind {law.kind} has no nominal stiffness that could be raised"
        )
    return {**described, "stiffness": stiffness}


def parameters(scene: Scene, law: dict[str, Any]) -> dict[str, Any]:
    """Return node parameters of an experiment: inverse of `sim.play.launched.from_launch`."""
    limited = (scene.peak, scene.slew, scene.workspace) != (None, None, None)
    if limited or scene.passivity is not None or scene.surface.kind == "free":
        raise ValueError(
            "a drop has a plane or an anchor, no limits by the driver and no guard"
        )
    at = scene.surface.position
    surface: dict[str, Any] = {"kind": "anchor", "position": [0.0, 0.0, at]}
    if scene.surface.kind == "plane":
        surface = {
            "kind": "plane",
            "axis": "z",
            "position": at,
            "normal": int(scene.surface.normal),
        }
    return {
        # The search goes beyond what a device tolerates: drop the limits of the launch
        # file.
        "driver": {"device": msgspec.to_builtins(scene.device), "safety": NO_LIMITS},
        "environment": {"surface": surface},
        "coupling": {
            "law": "tried",
            "laws": {"tried": law},
            "history": "position" if scene.raw else "penetration",
            "clamp": scene.clamp,
            "ease": scene.ease * scene.period,
            # Replace the launch file's own device by the dropped one.
            "stability": "off",
        },
    }


def _assignments(scene: Scene, ticks: int) -> dict[str, Any]:
    apply = "next_tick" if scene.next_tick else "on_arrival"
    return {
        "pace": "lockstep",
        "rate": 1.0 / scene.period,
        "duration": ticks * scene.period,
        "apply": apply,
    }


def _written(
    scene: Scene, law: dict[str, Any], ticks: int, folder: Path
) -> tuple[Path, LaunchedScene]:
    path = folder / "drop.yaml"
    # JSON is valid YAML and preserves floats bit by bit.
    path.write_text(json.dumps(parameters(scene, law)), encoding="utf-8")
    return path, from_launch(
        launch_file.read(SCENARIO, _assignments(scene, ticks), [path])
    )


def launched(scene: Scene, law: dict[str, Any], ticks: int) -> tuple[Array, Array]:
    """Play an experiment through the processes, in lockstep.

    Return the position read [m] and the force sent [N] at each tick.
    """
    with tempfile.TemporaryDirectory(prefix="haptic-drop-") as folder:
        path, read_back = _written(scene, law, ticks, Path(folder))
        if read_back.scene != scene or read_back.ticks != ticks:
            raise ValueError(
                f"{SCENARIO} plays {read_back.scene} for {read_back.ticks} ticks, wanted was"
                f" {scene}"
            )
        words = [
            f"{name}:={value}" for name, value in _assignments(scene, ticks).items()
        ]
        figures = measured_launch.launch(
            SCENARIO,
            *words,
            "--params",
            str(path),
            folder=Path(folder),
            timeout=60.0 + 0.1 * ticks,
        )
        states = Recording(Path(folder) / figures["recording"]).messages(DEVICE_STATE)
    if [state.seq for state in states] != list(range(ticks + 1)):
        raise MeasurementError(
            f"{len(states)} states were recorded, expected {ticks + 1} without a gap"
        )
    axis = read_back.axis
    position = np.array([state.position[axis] for state in states[:ticks]])
    # A state reports the force that ended the tick before it.
    return position, np.array([state.force[axis] for state in states[1:]])


def settles_launched(scene: Scene, law: dict[str, Any], criterion: Criterion) -> bool:
    """Play an experiment through the processes and judge its recording."""
    position, force = launched(scene, law, criterion.ticks)
    return settled(scene, compiled(scene, law), position, force, criterion)


def compiled(scene: Scene, law: dict[str, Any]) -> CompiledLaw:
    """Compile a law as a launch's coupling does."""
    with tempfile.TemporaryDirectory(prefix="haptic-drop-") as folder:
        return _written(scene, law, 1, Path(folder))[1].law


def last_settling(
    verdict: Callable[[float], bool], grid: Sequence[float]
) -> float | None:
    """Return the last K [N/m] of a rising grid that settles, by bisection.

    Its upper neighbour does not settle. None if the first does not settle, infinite if the last
    does: K_max lies outside the grid.
    """
    if not verdict(grid[0]):
        return None
    if verdict(grid[-1]):
        return math.inf
    low = 0
    high = len(grid) - 1
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if verdict(grid[middle]) else (low, middle)
    return grid[low]


def same_k_max(
    law: Law,
    scene: Scene,
    criterion: Criterion,
    grid: Sequence[float],
    step: Callable[[str, int], None] = lambda *_: None,
) -> SameKMax:
    """Find K_max of a law by launches and in one process, independently."""
    launches = 0

    def by_launch(stiffness: float) -> bool:
        nonlocal launches
        launches += 1
        good = settles_launched(scene, with_stiffness(law, stiffness), criterion)
        step(f"K = {stiffness:.6g} N/m {'settles' if good else 'does not settle'}", 1)
        return good

    def in_one_process(stiffness: float) -> bool:
        return settles(
            scene, [compiled(scene, with_stiffness(law, stiffness))], criterion
        )[0]

    found = last_settling(by_launch, grid)
    h1 = (
        None
        if found in (None, math.inf)
        else compiled(scene, with_stiffness(law, found)).h1
    )
    return SameKMax(found, last_settling(in_one_process, grid), h1, launches)
