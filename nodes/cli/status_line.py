"""Status line of a launch on a terminal: tick, penetration, force, law, safety, response.

It fits the terminal's width: the parts least relevant to a hand are dropped first.
"""

import sys
import time
from array import array
from collections.abc import Callable
from typing import Any

from messages.topics import DEVICE_STATE, FORCE, PROXY
from messages.transport.requests import ControlError, call
from messages.types import ZERO, Vector
from nodes.base.kept_line import columns, erased, is_smart, rewrite
from nodes.base.log_line import AS_JSON
from nodes.base.node_kinds import load
from nodes.cli.main import coloured
from nodes.environment.surfaces import Meeting, parse_surface
from nodes.launcher.launch_spec import Launch
from nodes.launcher.supervisor import Supervisor
from nodes.parameters.store import ParameterError

# time a node may take to answer; otherwise its parts are omitted [s]
ANSWER_TIMEOUT = 0.2
# Law and surface are asked for in every SLOW-th update: each request costs a loop microseconds.
SLOW = 3

PRIORITY = (
    "safety",
    "device",
    "penetration",
    "force",
    "law",
    "missed",
    "tick",
    "scenario",
    "response",
    "rate",
)
"""Parts of the line by priority; a narrow terminal shows the first ones."""

ORDER = (
    "scenario",
    "tick",
    "rate",
    "law",
    "penetration",
    "force",
    "missed",
    "response",
    "safety",
    "device",
)
"""Parts from left to right."""


def fitted(parts: dict[str, str], width: int) -> list[str]:
    """Return the parts that fit into `width`."""
    kept: set[str] = set()
    left = width
    for name in PRIORITY:
        need = len(parts[name]) + (2 if kept else 0) if parts.get(name) else width + 1
        if need <= left:
            kept.add(name)
            left -= need
    return [name for name in ORDER if name in kept]


def _meeting(surface: Any) -> Callable[[Vector], Meeting] | None:
    """Return the environment's contact function; None for an unknown surface."""
    try:
        return None if surface is None else parse_surface(surface, "surface").meeting()
    except ParameterError:
        return None


class StatusLine:
    """One line on the terminal while the loop runs; prints nothing without a terminal."""

    def __init__(self, launch: Launch) -> None:
        self._launch = launch
        self._axis = "xyz".index(launch.run.axes[0])
        self._before = (time.monotonic(), 0)
        # lines of data stand alone
        self._live = is_smart(sys.stderr) and not AS_JSON
        self._asked = 0
        self._law = ""
        self._meet: Callable[[Vector], Meeting] | None = None

    def __call__(self, supervisor: Supervisor) -> None:
        """Update the line."""
        now = self._ask(supervisor, DEVICE_STATE, "progress") if self._live else None
        if now is None:
            return
        if self._asked % SLOW == 0:
            self._law = (self._ask(supervisor, FORCE, "progress") or {}).get("law", "")
            self._meet = _meeting(
                self._ask(supervisor, PROXY, "param.get", name="surface")
            )
        self._asked += 1
        parts = self._parts(now, self._distance(now["position_m"]))
        chosen = [
            self._painted(name, parts[name])
            for name in fitted(parts, columns(sys.stderr))
        ]
        rewrite(sys.stderr, "  ".join(chosen))

    def _ask(
        self, supervisor: Supervisor, topic: str, op: str, **arguments: object
    ) -> Any:
        """Ask the node that publishes a topic; None if it does not answer."""
        for child in supervisor.children.values():
            if child.running and topic in load(child.setup.factory).publishes:
                try:
                    return call(
                        supervisor.context,
                        child.setup.control,
                        op,
                        timeout=ANSWER_TIMEOUT,
                        **arguments,
                    )
                except ControlError:
                    return None
        return None

    def _distance(self, position: list[float]) -> float | None:
        """Return the signed distance to the surface [m]; None without a surface nearby."""
        if self._meet is None:
            return None
        x, y, z = position
        _, normal, distance, _ = self._meet((x, y, z))
        return distance if normal != ZERO else None

    def _parts(self, now: dict[str, Any], distance: float | None) -> dict[str, str]:
        recent = array("d")
        recent.frombytes(now["recent_s"])
        responses = sorted(value for value in recent if value > 0.0) or [0.0]
        p50 = responses[len(responses) // 2] * 1e6
        p99 = responses[int(len(responses) * 0.99)] * 1e6
        clock = time.monotonic()
        ticks = now["tick"]
        rate = (ticks - self._before[1]) / (clock - self._before[0])
        self._before = (clock, ticks)
        of = f"/{now['ticks']}" if now["ticks"] else ""
        depth = distance or 0.0
        return {
            "scenario": self._launch.scenario,
            "tick": f"tick {ticks}{of}",
            "rate": f"{rate:.0f} Hz",
            "force": f"force {now['force_n'][self._axis]:+.2f} N",
            "law": f"law {self._law}" if self._law else "",
            "penetration": (
                f"{'penetration' if depth < 0.0 else 'distance'} {abs(depth) * 1e3:.2f} mm"
                if distance is not None
                else ""
            ),
            "missed": f"missed {now['missed']}",
            "response": f"p50 {p50:.0f} p99 {p99:.0f} µs",
            "safety": now["safety"],
            # Why a real device renders no force, or a different one.
            "device": now.get("condition", ""),
        }

    def _painted(self, name: str, text: str) -> str:
        colours = dict.fromkeys(("penetration", "force", "law"), "bold") | {
            "device": "red"
        }
        colours["safety"] = {"active": "green", "waiting": "dim", "ramp": "yellow"}.get(
            text, "red"
        )
        return coloured(text, colours[name], sys.stderr) if name in colours else text

    def clear(self) -> None:
        """Erase the line before other output."""
        if self._live:
            sys.stderr.write(erased(sys.stderr))
