"""Kinds of events and the numbers that each carries.

An event has a kind and numbers for programs, and one sentence for people. Programs read kind and
numbers; the wording of the sentence may change at any time. PROTOCOL.md has the same tables for
other languages.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final, Literal, NamedTuple, NewType, TypeAlias

from messages.errors import HapticError

__all__ = [
    "CHANGE",
    "DATA",
    "EVENTS",
    "EventKind",
    "Kind",
    "OtherKind",
    "UnknownEventError",
    "checked_data",
]

EventKind: TypeAlias = Literal[
    "axes",
    "bodies",
    "budget",
    "control",
    "delay",
    "denied",
    "descriptors",
    "device",
    "device_force",
    "device_force_back",
    "device_waits",
    "eased",
    "fallback",
    "frame",
    "guard",
    "hung",
    "inside",
    "kept",
    "law",
    "lease",
    "limit",
    "link",
    "listeners",
    "mesh",
    "partner",
    "realtime",
    "rearmed",
    "recording",
    "refused",
    "refused_future",
    "refused_not_finite",
    "refused_replayed",
    "refused_stale",
    "restart",
    "resumed",
    "ros2",
    "safety",
    "stability",
    "stale",
    "stopped",
    "target",
    "tick",
    "unanswered",
    "world",
    "wrench",
]
"""Kinds of events of this package."""

OtherKind = NewType("OtherKind", str)
"""Kind of an event of another package: ``package.kind``, with any finite numbers."""


class Kind(NamedTuple):
    """A kind of event."""

    meaning: str
    data: tuple[str, ...] = ()  # names of its possible numbers, of those in `DATA`


class UnknownEventError(HapticError, ValueError):
    """An event whose kind, or one of whose numbers, is not registered."""


DATA: Final[dict[str, str]] = {
    "after": (
        "state of the safety since then: 0 waiting, 1 ramp, 2 active, 3 damping, 4 zero, 5 fault, 6"
        " stopped"
    ),
    "age_s": "age of the message [s]",
    "age_ticks": "age of the force [ticks]",
    "align_m_per_s": "speed at which two devices are aligned, or brought together [m/s]",
    "answers_tick": "tick that the force answers",
    "apart_m": "distance of two devices [m]",
    "axis": "axis: 0 x, 1 y, 2 z",
    "before": "state of the safety before, as in `after`",
    "cause": "cause of the driver's event, see below",
    "delay_ticks": "time by which the virtual device answers later [ticks]",
    "energy_j": "energy that the loop gave out [J]",
    "expected": "listeners that were waited for",
    "force_step_n": "step of the force [N]",
    "from_tick": "tick of the last force that was handed over",
    "grown_bytes": "growth of the memory [bytes]",
    "high_m": "upper end of the workspace along the axis [m]",
    "last_tick": "tick of the latest message before",
    "limit_n": "limit of the force [N]",
    "limit_s": "limit of a time [s]",
    "limit_ticks": "limit of a number of ticks [ticks]",
    "listeners": "listeners that are connected",
    "low_m": "lower end of the workspace along the axis [m]",
    "lowered": "forces that the limit has lowered so far",
    "position_m": "position along the axis [m]",
    "ramp_s": "time in which a step of the force is eased [s]",
    "ramp_ticks": "length of the ramp [ticks]",
    "refused": "forces refused for this cause so far",
    "silent_s": "time without a message [s]",
    "silent_ticks": "ticks without a fresh force [ticks]",
    "solids": "solids that are not felt, because the tool began inside of them",
    "span_s": "time within which the force reached its limit `strokes` times [s]",
    "steps": "steps of the simulated world in one tick",
    "strokes": "times that the force reached its limit",
    "tick": "tick at which it happened",
    "tool_mass_kg": "mass of the tool [kg]",
    "x_m": "position along x [m]",
    "x_n": "force along x [N]",
    "y_m": "position along y [m]",
    "y_n": "force along y [N]",
    "z_m": "position along z [m]",
    "z_n": "force along z [N]",
}
"""Numbers of events by name, each with its meaning and, where it has one, its unit."""

CHANGE: Final = ("cause", "tick", "before", "after")
"""Numbers of every change of a driver's safety state."""

EVENTS: Final[dict[EventKind, Kind]] = {
    "axes": Kind("the surface pushes along an axis that the scene does not compute", ("axis",)),
    "bodies": Kind(
        "the scene of bodies was loaded, or its tool begins at the device again",
        ("tool_mass_kg", "steps"),
    ),
    "budget": Kind(
        "a law overran its time budget; the next time within a second the fallback takes over",
        ("tick",),
    ),
    "control": Kind("the thread that serves requests had an error"),
    "delay": Kind("the virtual device answers with another delay from now on", ("delay_ticks",)),
    "denied": Kind("a peer was not let in, or disconnected", ("grown_bytes",)),
    "descriptors": Kind("file descriptors run out; the node ends"),
    "device": Kind(
        "the device failed or was held up, what it is, or how two are paired",
        ("cause", "tick", "from_tick", "apart_m", "align_m_per_s"),
    ),
    "device_force": Kind("the device itself keeps forces from the hand; `reason` is its cause"),
    "device_force_back": Kind("the device gives forces again"),
    "device_waits": Kind("the device waits for something outside"),
    "eased": Kind(
        "position, surface or proxy jumped in contact; the force eases over it",
        ("tick", "force_step_n", "ramp_s"),
    ),
    "fallback": Kind("a law failed, and the fallback renders", ("tick",)),
    "frame": Kind("a message of the ROS 2 graph is in another frame, and refused"),
    "guard": Kind("the passivity guard lacks something it needs"),
    "hung": Kind("the node hangs, and is ended"),
    "inside": Kind("the tool begins inside of a solid, or has come outside", ("solids",)),
    "kept": Kind("what must outlive the process could not be saved"),
    "law": Kind("a law of the launch file cannot be switched to"),
    "lease": Kind("a lease has run out, and what was changed under it is reverted"),
    "limit": Kind(
        "a limit of the force was lowered to that of the device, or reached",
        ("cause", "tick", "limit_n", "lowered"),
    ),
    "link": Kind("a connection was lost, or another service answers"),
    "listeners": Kind(
        "not all listeners came in time; the run begins without them",
        ("listeners", "expected", "limit_s"),
    ),
    "mesh": Kind("a mesh was repaired"),
    "partner": Kind(
        "another person's device is heard, or silent", ("apart_m", "align_m_per_s", "silent_s")
    ),
    "realtime": Kind("the machine refused a real-time setting"),
    "rearmed": Kind("a driver that had stopped takes forces again, on request", CHANGE),
    "recording": Kind("a recording goes on in another file, or failed"),
    "refused": Kind("a message or a changed file was refused"),
    "refused_future": Kind(
        "a force for a later tick was refused", ("cause", "tick", "refused", "answers_tick")
    ),
    "refused_not_finite": Kind(
        "a force that is not finite was refused",
        ("cause", "tick", "refused", "answers_tick", "x_n", "y_n", "z_n"),
    ),
    "refused_replayed": Kind(
        "a force for a tick that was answered already was refused",
        ("cause", "tick", "refused", "answers_tick", "last_tick"),
    ),
    "refused_stale": Kind(
        "a force that is too old was refused",
        ("cause", "tick", "refused", "age_ticks", "limit_ticks"),
    ),
    "restart": Kind("the ticks of a sender went back", ("last_tick", "tick")),
    "resumed": Kind("the node goes on with the parameters of its predecessor", ("tick",)),
    "ros2": Kind("a topic of the ROS 2 graph is left out"),
    "safety": Kind(
        "the state of the driver's safety changed",
        (
            *CHANGE,
            "ramp_ticks",
            "silent_ticks",
            "limit_ticks",
            *("x_m", "y_m", "z_m"),
            *("axis", "position_m", "low_m", "high_m"),
        ),
    ),
    "stability": Kind("the law renders, and is judged unstable or not judged"),
    "stale": Kind("a message of the ROS 2 graph is too old, and refused", ("age_s", "limit_s")),
    "stopped": Kind(
        "the loop gave out energy, and the driver stopped it until `rearm`",
        (*CHANGE, "limit_n", "strokes", "span_s", "energy_j"),
    ),
    "target": Kind("a target of the ROS 2 graph was refused"),
    "tick": Kind("the compiled tick is not available"),
    "unanswered": Kind("a tick in lockstep has no answer, and is published again", ("tick",)),
    "world": Kind("the world was built, or a law and the world do not suit each other"),
    "wrench": Kind("a force of the ROS 2 graph was refused"),
}
"""Meaning and numbers of each kind."""

_KNOWN: Final[Mapping[str, Kind]] = {str(kind): known for kind, known in EVENTS.items()}


def checked_data(kind: EventKind | OtherKind, data: Mapping[str, float]) -> dict[str, float]:
    """Return the finite numbers in the `data` of an event of a `kind`.

    Returns
    -------
    dict of str to float
        The numbers by name.

    Raises
    ------
    UnknownEventError
        If `kind` is neither in `EVENTS` nor ``package.kind``, or the kind has no such number.
    """
    known = _KNOWN.get(kind)
    if known is None and "." not in kind:
        raise UnknownEventError(
            f"event kind {kind!r}: not in messages/event_kinds.py; a kind of another package is"
            " written package.kind"
        )
    if known is not None and (unknown := sorted(set(data) - set(known.data))):
        raise UnknownEventError(
            f"event {kind!r}: no number is named {', '.join(unknown)}; known:"
            f" {', '.join(known.data) or 'none'}"
        )
    return {name: float(value) for name, value in data.items() if math.isfinite(value)}
