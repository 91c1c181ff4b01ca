"""Why there is a force, or none, as text: one table for driver, page and command line.

The rules of a driver note a code with numbers. `NOTES` names the numbers, which are sent with the
driver's event, and contains the sentence that is made from them. `STATES` says what each state of
the safety does, and the remedy.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final, NamedTuple

from messages.event_kinds import EventKind
from messages.types import DeviceState, Event, Force, Proxy, Vector
from nodes.driver import notes
from nodes.driver.state import FAULT, NOTE, SAFETY, DriverState
from nodes.parameters.interface_words import COMMAND_LINE

# time without a state after which a driver counts as silent [s]
SILENT_AFTER: Final = 0.5
NO_FORCE: Final = 1e-9  # a force below this counts as zero [N]
LEAST_SHOWN: Final = 0.005  # a force below this would be told as 0.00 N [N]


class StateWords(NamedTuple):
    """Action of the driver in one state of its safety."""

    text: str
    remedy: str  # for the user, with `{rearm}` as a word; empty if none is needed


STATES: Final[Mapping[str, StateWords]] = {
    "waiting": StateWords(
        "the driver waits for the first force of the coupling",
        "does it run, and does the environment? haptic node list",
    ),
    "ramp": StateWords("the force ramps up after a start or a gap", ""),
    "active": StateWords("the driver applies the law's force", ""),
    "damping": StateWords(
        "the coupling is late; the driver damps the device", "haptic node list"
    ),
    "zero": StateWords(
        "the coupling is silent; the force is zero until a fresh one arrives",
        "haptic node list",
    ),
    "fault": StateWords(
        "the device is outside its workspace, or has no valid position",
        "move the handle back, or see mapping",
    ),
    "stopped": StateWords(
        "the loop was unstable, and the driver stopped it",
        "choose a softer law, then {rearm}",
    ),
}


class Note(NamedTuple):
    """Meaning of one code of the rules."""

    kind: EventKind
    # names of its numbers, in the order in which the rules note them
    fields: tuple[str, ...]
    text: str  # sentence, filled by name
    short: str = ""  # short form for the page, if different
    remedy: str = ""  # what to do about it, with `{rearm}` as a word; empty if nothing


NOTES: Final[Mapping[int, Note]] = {
    notes.FIRST_FORCE: Note("safety", (), "the first force"),
    notes.FRESH_FORCE: Note("safety", (), "fresh forces again"),
    notes.DONE_RAMP: Note(
        "safety", ("ramp_ticks",), "ramp of {ramp_ticks:.0f} ticks done"
    ),
    notes.SILENT: Note(
        "safety",
        ("silent_ticks", "limit_ticks"),
        "no fresh force for {silent_ticks:.0f} ticks, limit {limit_ticks:.0f}",
    ),
    notes.STILL_SILENT: Note(
        "safety", ("silent_ticks",), "no fresh force for {silent_ticks:.0f} ticks"
    ),
    notes.LET_GO: Note(
        "safety",
        (),
        "no force was written in time, and the device released the old one",
    ),
    notes.NO_POSITION: Note(
        "safety",
        ("x_m", "y_m", "z_m"),
        "the device returned position ({x_m}, {y_m}, {z_m})",
    ),
    notes.OUTSIDE: Note(
        "safety",
        ("axis", "position_m", "low_m", "high_m"),
        "{axis} = {position_m:.4g} m, workspace {low_m:.4g} to {high_m:.4g} m",
    ),
    notes.BACK_INSIDE: Note("safety", (), "back inside the workspace"),
    notes.SWINGS: Note(
        "stopped",
        ("limit_n", "strokes", "span_s", "energy_j"),
        "the loop generates energy: its force reached the limit of {limit_n:g} N, or stayed there,"
        " {strokes:.0f} times within {span_s:.2g} s and generated {energy_j:.3g} J; no force until"
        " rearmed",
        "{strokes:.0f} strokes to the limit of {limit_n:g} N within {span_s:.2g} s, {energy_j:.3g}"
        " J generated",
        "choose a softer law, then {rearm}, or launch again",
    ),
    notes.CONTINUOUS: Note(
        "limit",
        ("lowered", "limit_n"),
        "continuous force at tick {tick:.0f}: limit {limit_n:.3g} N reached",
    ),
    notes.HELD_UP: Note(
        "device",
        ("from_tick",),
        "no force from tick {from_tick:.0f} to {tick:.0f}; the device released the force itself",
    ),
    notes.REARMED: Note(
        "rearmed",
        (),
        "rearmed on request: the force ramps up, and oscillations are counted from zero",
    ),
    notes.JUMPED: Note(
        "safety", (), "the position jumped without motion: the force changes by a ramp"
    ),
    notes.REFUSED_FIRST: Note(
        "refused_future",
        ("refused", "answers_tick"),
        "a force for the future tick {answers_tick:.0f}: now is tick {tick:.0f}",
    ),
    notes.REFUSED_FIRST + 1: Note(
        "refused_replayed",
        ("refused", "answers_tick", "last_tick"),
        "a force for tick {answers_tick:.0f}, but tick {last_tick:.0f} was answered already"
        " (replayed or out of order)",
    ),
    notes.REFUSED_FIRST + 2: Note(
        "refused_stale",
        ("refused", "age_ticks", "limit_ticks"),
        "a force {age_ticks:.0f} ticks old at tick {tick:.0f}, limit {limit_ticks:.0f}",
    ),
    notes.REFUSED_FIRST + 3: Note(
        "refused_not_finite",
        ("refused", "answers_tick", "x_n", "y_n", "z_n"),
        "a force for tick {answers_tick:.0f} that is not finite: ({x_n}, {y_n}, {z_n})",
    ),
}


class Noted(NamedTuple):
    """A note of the rules, as its event carries it."""

    kind: EventKind
    reason: str
    data: dict[str, float]
    is_change: bool  # whether the state of the safety changed
    nth: int  # number among those of its kind, if the rules count them; else 0


def _filled(text: str, data: Mapping[str, float]) -> str:
    """Return a sentence of `NOTES` filled with numbers."""
    shown: dict[str, Any] = dict(data)
    if "axis" in data:
        shown["axis"] = "xyz"[int(data["axis"])]
    return text.format_map(shown)


def _worded(remedy: str) -> str:
    """Return a remedy in the command line's words, whatever started the launch.

    Recordings keep it, and every interface reads them; Python words it anew.
    """
    return remedy.format(rearm=COMMAND_LINE.rearm)


def take_notes(s: DriverState) -> list[Noted]:
    """Return and clear the notes of the rules since the last call."""
    found = []
    for n in range(s.notes_count):
        code, seq, change, *numbers = s.notes[NOTE * n : NOTE * (n + 1)]
        note = NOTES[int(code)]
        data = {
            "cause": code,
            "tick": seq,
            **dict(zip(note.fields, numbers, strict=False)),
        }
        reason = _filled(note.text, data)
        if note.remedy:
            reason = f"{reason}: {_worded(note.remedy)}"
        if change >= 0.0:
            before, after = divmod(int(change), 8)
            data |= {"before": float(before), "after": float(after)}
            reason = f"{SAFETY[before]} → {SAFETY[after]} at tick {seq:.0f}: {reason}"
        # rules count the forces that they refuse or lower
        count = data.get("refused", data.get("lowered", 0.0))
        found.append(Noted(note.kind, reason, data, change >= 0.0, int(count)))
    s.notes_count = 0
    return found


def cause_of(event: Event) -> str:
    """Return the cause of a driver's event without the change of state, or its `reason`."""
    note = NOTES.get(int(event.data.get("cause", -1)))
    # events of older recordings have no numbers, and values that are not finite are left out
    if note is None or not event.data.keys() >= {"tick", *note.fields}:
        return event.reason
    return _filled(note.short or note.text, event.data)


def why_no_force(s: DriverState, condition: str = "") -> str:
    """Return from the driver's state why there is no force on the hand, or how large it is.

    `condition` is the device's own.
    """
    if s.ticks == 0:
        return "the driver has not ticked yet"
    if condition:
        return condition
    state = STATES[SAFETY[s.safety]]
    name = SAFETY[s.safety]
    place = ", ".join(f"{x:.4g}" for x in s.place)
    if s.safety == FAULT:
        ends = "; ".join(
            f"{s.workspace[2 * i]:.3g} to {s.workspace[2 * i + 1]:.3g}"
            for i in range(3)
        )
        remedy = _worded(state.remedy)
        return f"{state.text}: position ({place}) m, workspace ({ends}) m; {remedy}"
    if name not in ("active", "ramp"):
        return f"{state.text}: {_worded(state.remedy)}"
    force = ", ".join(f"{x:.3g}" for x in s.force)
    if not any(s.force):
        left = ["xyz"[i] for i in range(3) if i not in list(s.axis[: s.axes])]
        beside = (
            f"; along {' and '.join(left)} the scene computes nothing" if left else ""
        )
        return (
            f"the law asks for none: nothing is touched at ({place}) m{beside}. A surface out of"
            " the device's reach needs a mapping, or the device a re-centre"
        )
    if name == "ramp":
        return f"({force}) N: {state.text}"
    lowered = sum(s.limited_by)
    return f"({force}) N are handed to the device" + (
        f"; its limits held {lowered} of them back" if lowered else ""
    )


def size(vector: Vector) -> float:
    """Return the length of a vector."""
    return math.sqrt(sum(part * part for part in vector))


def explain(
    state: DeviceState | None,
    proxy: Proxy | None,
    force: Force | None,
    silent: float,
    why: str = "",
    ringing: str = "",
    device: str = "",
) -> tuple[str, str]:
    """Return why there is a force or none, from the messages of a run: a level and a sentence.

    Parameters
    ----------
    state, proxy, force : DeviceState, Proxy, Force or None
        Newest messages; None before the first one.
    silent : float
        Time since the driver's last state [s].
    why : str
        Cause of the last change of state (`cause_of`).
    ringing : str
        How the loop oscillates; empty if it does not.
    device : str
        Why the device gives no forces; empty if it does or nothing is known.

    Returns
    -------
    level : str
        ``ok``, ``rest``, ``warn`` or ``stop``.
    text : str
        The sentence.
    """
    if state is None:
        return "rest", "No force: the driver has not ticked yet."
    if silent > SILENT_AFTER:
        return "stop", f"No force: nothing has come from the driver for {silent:.1f} s."
    because = f" ({why})" if why else ""
    given = size(state.force)
    words = STATES[state.safety].text if state.safety in STATES else ""
    if state.safety == "stopped":
        return "stop", f"Too hard: {words}{f': {why}' if why else ''}."
    if words and state.safety not in ("active", "ramp"):
        if state.safety != "damping" and given <= NO_FORCE:
            return "stop", f"No force: {words}{because}."
        return "warn", f"{given:.2f} N: {words}{because}."
    if device:
        # It accepts the driver's forces, and does not apply them.
        return "stop", f"No force, or another one: {device}."
    law = force.law if force is not None else ""
    if law == "fallback":
        return (
            "warn",
            f"{given:.2f} N: the law failed, so the fallback renders; choose a law to go on.",
        )
    if state.safety == "ramp":
        return "warn", f"{given:.2f} N: {words}."
    if proxy is None:
        # A recording of states only has no answer.
        begin = f"{given:.2f} N" if given > NO_FORCE else "No force"
        return "warn", f"{begin}: the environment has not answered yet."
    if ringing:
        return "warn", f"{ringing}: this wall is harder than the loop can render."
    return _in_contact(state, proxy, force, given)


def _in_contact(
    state: DeviceState, proxy: Proxy, force: Force | None, given: float
) -> tuple[str, str]:
    """Return level and sentence of a loop without faults."""
    if not proxy.contact:
        if any(proxy.normal):
            return (
                "rest",
                (
                    f"No force: nothing is touched; the surface is {abs(proxy.distance) * 1e3:.1f}"
                    " mm away."
                ),
            )
        return "rest", "No force: there is nothing to touch."
    law = force.law if force is not None and force.law else "the law"
    asked = size(force.force) if force is not None else 0.0
    # another tick's force does not show limits
    same = force is not None and force.seq == state.force_seq
    if (
        same
        and asked > given + 0.02 * asked + NO_FORCE
        and state.age == 0
        and asked > 0.05
    ):
        return (
            "warn",
            (
                f"{given:.2f} N of the {asked:.2f} N that the law asks for: the driver's limits"
                " hold the rest back."
            ),
        )
    if given <= NO_FORCE:
        return "rest", f"No force: {law} renders none at this deflection."
    if given < LEAST_SHOWN:
        return "rest", f"No force to feel: {law} renders less than 0.01 N."
    depth = f", {abs(proxy.distance) * 1e3:.2f} mm deep" if any(proxy.normal) else ""
    return "ok", f"{given:.2f} N: {law} pushes back{depth}."
