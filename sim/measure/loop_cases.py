"""What a tick may have to do beside the ordinary: a guard, a cross-fade, and a device behind its own servo loop.

Each is the same launch as the ordinary one, with a file of parameters laid over it, or with a stand-in of a real device in the
place of the virtual one. So what differs between two figures is that one thing.
"""

from __future__ import annotations

import contextlib
import json
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from nodes.launcher import launch_file
from nodes.parameters.yaml_io import read_yaml
from sim.stand_ins.world import library

SCENARIO: Final = "floor_drop"

LONGEST_FADE: Final = 100_000
"""A ramp has no more ticks; a longer round goes on with the law that came."""

SERVO_RATE: Final = 4000
"""Of the stand-in, and of the loop that is compared with the virtual device [Hz]: a servo loop that keeps step with it."""

ARM: Final[Mapping[str, Any]] = {"serial": 1234, "ready_time": 5.0, "servo_rate": SERVO_RATE}
"""The stand-in of a Force Dimension device, as its driver is told of it."""

CASES: Final = {"guard": "guard on", "fade": "during a cross-fade", "stand_in": "stand-in of a device"}
"""Each with what it is called."""


def given(case: str) -> dict[str, Any]:
    """Give what is laid over the parameters of the nodes."""
    if case == "guard":
        # An account without end: nothing is lowered, and the work is done.
        return {"driver": {"passivity": {"guard": "on", "allowance": 1e3}}}
    if case == "fade":
        return {"coupling": {"schedule": [{"at": 0.0, "law": "pd_alpha", "ramp": LONGEST_FADE}]}}
    return {}


def _with_arm(folder: Path) -> str:
    """Write the launch with the stand-in in place of the virtual device: an arm that somebody holds in the wall."""
    path, world = library("dhd", folder)
    world.state.position[2] = -0.001
    content = read_yaml(launch_file.find(SCENARIO))
    driver = content["nodes"]["driver"]
    safety = driver["parameters"]["safety"]
    driver["kind"] = "force_dimension_driver"
    driver["parameters"] = {"safety": safety, "force_dimension": {**ARM, "library": str(path)}}
    # What the launch file says of the virtual device only.
    del content["model"]
    for name in ("mass", "height"):
        del content["arguments"][name]
    content["nodes"]["coupling"]["parameters"]["plant"]["mass"] = world.state.mass
    written = folder / "stand_in.yaml"
    written.write_text(json.dumps(content), encoding="utf-8")
    return str(written)


@contextlib.contextmanager
def launches(cases: Sequence[str]) -> Iterator[dict[str, tuple[str, ...]]]:
    """Make the arguments of ``haptic launch`` for each case; ``""`` is the ordinary launch.

    Raises OSError when a stand-in cannot be compiled here.
    """
    with tempfile.TemporaryDirectory(prefix="haptic-cases-") as place:
        found: dict[str, tuple[str, ...]] = {"": (SCENARIO,)}
        for case in cases:
            if case == "stand_in":
                found[case] = (_with_arm(Path(place)),)
                continue
            path = Path(place) / f"{case}.yaml"
            path.write_text(json.dumps(given(case)), encoding="utf-8")
            found[case] = (SCENARIO, "--params", str(path))
        yield found
