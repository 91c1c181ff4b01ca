"""Scenes in three axes against the floor at 500 Hz: misses, response and environment time.

The launches alternate, and each is started as by a user. A ball of many triangles replaces the one
of ``sphere_feel``. The environment's own time runs from the received message to the stamp of the
answer, as the node measures it.
"""

import statistics
import struct
import tempfile
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from nodes.base.setup import Tick
from sim.lab.proxy_shapes import icosphere
from sim.measure.measured_launch import launch, machine
from sim.measure.stopwatch import Progress

FLOOR = "floor_drop"  # reference for all others
# scenes with moving bodies; their environment is MuJoCo, called from Python
BODIES = ("puck_push", "stack_boxes")
_BALL = {
    "radius": 0.035,
    "position": [0.05, 0.01, -0.03],
}  # the sphere of ``sphere_feel`` [m]
_SURFACE = """environment: {{surface: {{kind: mesh, file: {file}, position: {position}, \
tool_radius: 0.001}}}}
"""


def ball_file(folder: Path, halvings: int) -> Path:
    """Write a ball of 20·4ⁿ triangles as a binary STL; return its path."""
    triangles = icosphere(halvings, float(_BALL["radius"]))  # type: ignore[arg-type]
    path = folder / "ball.stl"
    records = (
        struct.pack("<12fH", 0.0, 0.0, 0.0, *triangle, 0)
        for triangle in triangles.reshape(-1, 9).tolist()
    )
    path.write_bytes(
        b"ball".ljust(80) + struct.pack("<I", len(triangles)) + b"".join(records)
    )
    return path


def scenes(folder: Path, halvings: int) -> dict[str, list[str]]:
    """Return the scenes: name and arguments of the launch."""
    given = folder / "ball.yaml"
    given.write_text(
        _SURFACE.format(file=ball_file(folder, halvings), position=_BALL["position"]),
        encoding="utf-8",
    )
    found = {name: [name] for name in (FLOOR, "sphere_feel", "mesh_pebble")}
    found[f"ball of {20 * 4**halvings} triangles"] = [
        "sphere_feel",
        "--params",
        str(given),
    ]
    return found | ({name: [name] for name in BODIES} if find_spec("mujoco") else {})


def compare_scenes(
    rounds: int, seconds: float, halvings: int, tick: Tick
) -> dict[str, Any]:
    """Launch floor and scenes alternately, in rotating order.

    Return rows of medians over the launches, and the machine.
    """
    with tempfile.TemporaryDirectory(prefix="haptic-") as folder:
        found = scenes(Path(folder), halvings)
        runs: dict[str, list[dict[str, Any]]] = {name: [] for name in found}
        names, progress = list(found), Progress(rounds * len(found))
        for k in range(rounds):
            for name in names[k % len(names) :] + names[: k % len(names)]:
                runs[name].append(
                    launch(*found[name], f"duration:={seconds}", "--tick", tick)
                )
                progress.step(name)
    return {
        "rows": [_row(name, taken) for name, taken in runs.items()],
        "machine": machine(),
    }


def _row(name: str, runs: list[dict[str, Any]]) -> dict[str, Any]:
    lost = sum(run["missed"] + run["overruns"] for run in runs)
    row: dict[str, Any] = {
        "scene": name,
        "tick": runs[0]["tick_by_node"]["environment"],
        "ticks": sum(run["ticks"] for run in runs),
        "missed": lost,
        "missed_share": lost
        / max(1, sum(run["ticks"] + run["overruns"] for run in runs)),
    }
    found = {
        "response_us": [run["response_us"] for run in runs],
        "spent_us": [run["spent_us"]["environment"] for run in runs],
    }
    for key, quantiles in found.items():
        row[key] = {
            part: statistics.median(each[part] for each in quantiles)
            for part in ("p50", "p99")
        }
    return row


def text(rows: list[dict[str, Any]]) -> list[str]:
    """Return the table as text lines."""
    lines = [
        f"{'500 Hz':26}{'environment':>14}{'its time [µs]':>20}{'response [µs]':>20}{'missed':>18}"
    ]
    lines.append(f"{'':26}{'':>14}{'p50':>10}{'p99':>10}{'p50':>10}{'p99':>10}")
    for row in rows:
        spent, response = row["spent_us"], row["response_us"]
        lines.append(
            f"{row['scene']:26}{row['tick']:>14}{spent['p50']:10.3g}{spent['p99']:10.3g}"
            f"{response['p50']:10.0f}{response['p99']:10.0f}{row['missed']:9d}"
            f" ({row['missed_share']:.2%})"
        )
    return lines
