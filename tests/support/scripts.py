"""Scripts for each kind of node: driver, environment and coupling."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from messages import topics
from messages.codec import encode
from messages.types import DeviceState, Force, Message, Proxy, Vector
from nodes.coupling.node import Coupling
from nodes.driver.device import DeviceLimits
from nodes.environment.node import Environment
from tests.support.scripted import Hand, Script, ScriptedDriver
from tests.support.scripted_world import EPOCH, TICK, Arrival, at

BOX = ((-0.1, 0.1),) * 3
TICKS = 120
LAWS = {
    "pd": {"kind": "pd", "stiffness": 500.0, "damping": 3.0},
    "pd_filtered": {
        "kind": "pd_filtered",
        "stiffness": 500.0,
        "damping": 3.0,
        "cutoff": 60.0,
    },
}
KINDS: dict[str, tuple[type[Any], dict[str, Any]]] = {
    "environment": (Environment, {"surface": {"kind": "plane"}}),
    # One law of taps alone, one with a recursive section, which sees what is bridged too.
    **{
        law: (
            Coupling,
            {
                "law": law,
                "laws": LAWS,
                "memory": 16,
                "stability": "off",
                "figures": False,
            },
        )
        for law in LAWS
    },
}
"""Followers of a driver: class and parameters."""


def moving(seq: int) -> Vector:
    """Return positions that move on two axes, never the same distance twice in a row."""
    return 0.0, 1e-4 * (seq * 7 % 13), -1e-3 - 2e-5 * (seq * 5 % 17)


def answer(seq: int, after: float = 600.0, force: Vector | None = None) -> Arrival:
    """Return the answer to a tick, some microseconds after its start."""
    given = (0.0, 0.1, 1.0 + 0.05 * (seq * 3 % 7)) if force is None else force
    return Arrival(
        at(seq, after),
        (topics.FORCE.encode(), encode(Force(seq=seq, stamp=0.0, force=given))),
    )


def answers_but(*left_out: int) -> list[Arrival]:
    """Return answers to every tick except some."""
    return [answer(seq) for seq in range(TICKS) if seq not in left_out]


def driver(
    arrivals: Sequence[Arrival],
    late: Mapping[int, int] | None = None,
    position: Callable[[int], Vector] = moving,
    limits: Mapping[str, Any] | None = None,
    guard: Mapping[str, Any] | None = None,
    ticks: int = TICKS,
    **safety: Any,
) -> Script:
    """Return the script of a driver; its first force has a ramp only if requested."""
    bears = DeviceLimits(
        **{
            "peak_force": 8.0,
            "hold": 10.0,
            "workspace": BOX,
            "latency": 0.0,
            **(limits or {}),
        }
    )
    return Script(
        ScriptedDriver,
        arrivals,
        {
            "safety": {"hang": None, "ramp": 0.0, **safety},
            **({"passivity": guard} if guard else {}),
        },
        late or {},
        ticks,
        hand=lambda: Hand(bears, position),
    )


def question(kind: str, seq: int, stamp: float) -> Message:
    """Return the message that a node answers."""
    depth = -1e-3 - 1e-5 * (seq * 7 % 11)
    position = (0.0, 0.0, depth)
    if kind == "environment":
        return DeviceState(
            seq=seq, stamp=stamp, position=position, force=(0.0, 0.0, 0.0), delay=0.1
        )
    return Proxy(
        seq=seq,
        stamp=stamp,
        position=position,
        proxy=(0.0, 0.0, 0.0),
        normal=(0.0, 0.0, 1.0),
        distance=depth,
        contact=True,
        delay=0.1,
    )


def follower(
    kind: str, coming: Sequence[tuple[int, float]], pace: str = "realtime"
) -> Script:
    """Return the script of a node that follows ticks, one a period.

    Each question comes `late` µs after its period's start.
    """
    made, parameters = KINDS[kind]
    topic = made.listens_to[0].encode()
    arrivals = [
        Arrival(
            at(place, late),
            (topic, encode(question(kind, seq, 1e-9 * (EPOCH + TICK * place)))),
        )
        for place, (seq, late) in enumerate(coming)
    ]
    return Script(made, arrivals, parameters, pace=pace)
