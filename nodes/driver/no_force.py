"""Why no force is felt: the first thing on the way from the law to the hand that keeps it from getting there, in words."""

from __future__ import annotations

from typing import Final

from nodes.driver.state import ACTIVE, DAMPING, FAULT, IDLE, NOTHING, RAMP, SAFETY, STOPPED, DriverState

_STATES: Final = {
    IDLE: "no force has come from the coupling yet: does it run, and does the environment? haptic node list",
    DAMPING: "no fresh force comes from the coupling: the driver damps",
    NOTHING: "no fresh force comes from the coupling, and the driver gives none",
    STOPPED: "the loop swung, and the driver has stopped it for good: a softer law, then haptic node rearm",
}


def why_no_force(s: DriverState, condition: str = "") -> str:
    """Say what keeps a force from the hand (`condition`: what the device itself says), or how much is handed over."""
    if s.ticks == 0:
        return "the driver has not ticked yet"
    if condition:
        return condition
    place = ", ".join(f"{x:.4g}" for x in s.place)
    if s.safety == FAULT:
        ends = "; ".join(f"{s.workspace[2 * i]:.3g} to {s.workspace[2 * i + 1]:.3g}" for i in range(3))
        return f"the position ({place}) m is none, or outside the workspace ({ends}) m: move the handle back, or see mapping"
    if s.safety in _STATES:
        return _STATES[s.safety]
    force = ", ".join(f"{x:.3g}" for x in s.force)
    if not any(s.force):
        left = ["xyz"[i] for i in range(3) if i not in list(s.axis[: s.axes])]
        beside = f"; along {' and '.join(left)} the scene computes nothing" if left else ""
        return (
            f"the law asks for none: nothing is touched at ({place}) m{beside}. A surface out of the device's reach needs a "
            "mapping, or the device a re-centre"
        )
    if s.safety == RAMP:
        return f"({force}) N, growing: a force that was away comes back by a ramp"
    assert s.safety == ACTIVE, SAFETY[s.safety]  # noqa: S101  # all others are dealt with above
    held = sum(s.limited_by)
    return f"({force}) N are handed to the device" + (f"; its limits held {held} of them back" if held else "")
