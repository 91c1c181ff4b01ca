"""Random launches as they are drawn: scene, device, law and pace."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from random import Random
from typing import Any, Final

from sim.drill.drill import scene

STIFFNESS, DAMPING = 1200.0, 3.0  # upper limits of the laws below [N/m, N s/m]
ORDER, LOG = "order", "writes.log"  # files of the faulty device
RAMP: Final = 0.15  # ramp of driver and coupling for forces not caused by motion [s]
LAWS: Final[Mapping[str, dict[str, Any]]] = {
    "pd": {"kind": "pd", "stiffness": 1000.0, "damping": DAMPING},
    "soft": {"kind": "pd", "stiffness": 500.0, "damping": 2.0},
    "light": {"kind": "pd", "stiffness": 500.0, "damping": 1.0},
}


def _floor(random: Random, content: dict[str, Any]) -> str:
    """Set a hand that presses into a floor, starting inside or outside; return a description."""
    height = random.uniform(-0.004, 0.004)
    content["nodes"]["driver"]["parameters"]["device"]["position"] = height
    return f"floor, begins at {1e3 * height:.2g} mm"


def _drop(random: Random, content: dict[str, Any]) -> str:
    """Set a mass without a hand, dropped on a floor or inside it; return a description."""
    height = random.uniform(-0.002, 0.01)
    device = content["nodes"]["driver"]["parameters"]["device"]
    del device["hand"]
    device |= {"gravity": 9.81, "position": height}
    return f"drop from {1e3 * height:.2g} mm"


def _sphere(random: Random, content: dict[str, Any]) -> str:
    """Set a hand that moves over a sphere, in three axes; return a description."""
    content["run"]["axes"] = ["x", "y", "z"]
    device = content["nodes"]["driver"]["parameters"]["device"]
    device["hand"] = {
        "mass": 0.05,
        "damping": 3.0,
        "stiffness": 150.0,
        "path": [[0.0, -0.02], [1.0, 0.02], [2.0, -0.02]],
    }
    device["hand"]["repeat"] = 2.0
    depth = random.uniform(-0.002, 0.002)
    surface = {
        "kind": "sphere",
        "position": [0.0, 0.0, -0.03],
        "radius": 0.03 + depth,
        "tool_radius": 0.001,
    }
    content["nodes"]["environment"]["parameters"]["surface"] = surface
    return f"sphere, begins {1e3 * depth:.2g} mm inside"


SCENES: Final[tuple[Callable[[Random, dict[str, Any]], str], ...]] = (
    _floor,
    _drop,
    _sphere,
)


def drawn(
    random: Random, ticks: Sequence[str] = ("plain", "compiled")
) -> tuple[dict[str, Any], str]:
    """Return a random launch file, and its description."""
    content = scene()
    driver = content["nodes"]["driver"]
    driver["kind"] = "faulty_driver"
    driver["parameters"] |= {"order": ORDER, "log": LOG}
    driver["parameters"]["safety"] |= {"ramp": None, "recovery": RAMP}
    content["nodes"]["coupling"]["parameters"] |= {
        "laws": dict(LAWS),
        "law": random.choice(list(LAWS)),
        "ease": RAMP,
    }
    del content["nodes"]["logger"]
    what = random.choice(SCENES)(random, content)
    tick = random.choice(list(ticks))
    apply = random.choice(("on_arrival", "next_tick"))
    content["run"] |= {"tick": tick, "apply": apply}
    return content, f"{what}, {tick} tick, {apply}"
