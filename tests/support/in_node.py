"""Plays launches by the emitted rules in node, for comparison with `haptic.play`."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from nodes.launcher.launch_spec import Launch
from sim.static_page.emitted_rules import constant, player
from sim.static_page.image import image_of

ROWS = ("position", "velocity", "measured", "deflection", "force")

PLAYED = (
    "box_edges",
    "floor_buzz",
    "floor_drop",
    "floor_drop_fast",
    "floor_guarded",
    "floor_swap",
    "free_space",
    "identify",
    "mesh_pebble",
    "reach",
    "ros2_wall",
    "rough_plane",
    "sphere_feel",
    "touch_wall",
    "two_loggers",
    "wall_press",
)
"""Scenarios that a page in the browser plays."""

_RUN = """
const played = (image, ticks, targets) => {
  top_ = 8; PAIRS.clear(); now = 0.0;
  const p = new Player(image), rows = new Float64Array(15 * ticks), contact = [];
  for (let k = 0; k < ticks; k++) {
    if (targets) for (const d of p.devices) {
      d.led = 1;
      d.pull = targets[3 * k + d.axis];
    }
    const at = (row, i) => 15 * k + 3 * row + i;
    p.tick();
    const s = p.driver;
    for (let i = 0; i < 3; i++) {
      rows[at(2, i)] = s.position[i];
      rows[at(3, i)] = p.deflection[i];
      rows[at(4, i)] = s.force[i];
    }
    for (const { axis, x, v } of p.before) [rows[at(0, axis)], rows[at(1, axis)]] = [x, v];
  }
  return [rows, p];
};
"""


class Swap(NamedTuple):
    """A change of law at a tick."""

    tick: int
    law: str  # name of the law, among those of the launch file
    ramp: int  # cross-fade [ticks]


class Case(NamedTuple):
    """A launch to be played."""

    launch: Launch
    ticks: int
    target: Any = None  # targets of the hand [m], shape (ticks, 3); None: its path
    swaps: Sequence[Swap] = ()  # swaps besides those of the launch file


def node() -> str:
    """Return the path of node; skips the test where there is none."""
    found = shutil.which("node")
    if found is None:
        pytest.skip("node is not installed")
    return found


def program(cases: Sequence[Case]) -> str:
    """Return a script that plays cases and collects their rows in `results`."""
    parts = [player(), _RUN, "const results = [];\n"]
    for n, case in enumerate(cases):
        targets = "null" if case.target is None else f"TARGET_{n}"
        image = image_of(case.launch, case.ticks)
        if case.swaps:
            image["schedule"] = [swap._asdict() for swap in case.swaps]
        parts.append(constant(f"IMAGE_{n}", image))
        if case.target is not None:
            parts.append(constant(f"TARGET_{n}", np.asarray(case.target).ravel()))
        parts.append(f"results.push(played(IMAGE_{n}, {case.ticks}, {targets}));\n")
    return "".join(parts)


def play_in_node(cases: Sequence[Case], directory: Path, script: str = "") -> list[Any]:
    """Return the rows of each case, shape (5, ticks, 3), in the order of `ROWS`."""
    path, out = directory / "played.js", directory / "played.bin"
    path.write_text(
        (script or program(cases))
        + 'require("fs").writeFileSync(process.argv[2],'
        + " Buffer.concat(results.map(([rows]) => Buffer.from(rows.buffer))));\n"
    )
    done = subprocess.run(
        [node(), str(path), str(out)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-3000:]
    numbers = np.frombuffer(out.read_bytes())
    ends = np.cumsum([15 * case.ticks for case in cases])
    return [
        part.reshape(case.ticks, 5, 3).transpose(1, 0, 2)
        for case, part in zip(cases, np.split(numbers, ends[:-1]), strict=True)
    ]
