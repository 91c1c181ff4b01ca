"""Kinds of world by name, as `haptic.k_max` reads them."""

from __future__ import annotations

from typing import Any

from nodes.stability.plant import Plant
from nodes.stability.worlds import AnyWorld, EulerTool, OtherDevice, Springs, SteppedTool, Wall, WorldKind

# Name to the options that it needs and whether any hand may hold the device.
NAMES: dict[str, tuple[tuple[str, ...], bool]] = {
    "wall": ((), False),
    "spring": (("springs",), False),
    "any": ((), False),
    "any_hand": ((), True),
    "any_hand_wall": ((), True),
    "tool": (("tool_damping",), False),
    "any_hand_tool": (("tool_damping",), True),
    "euler_tool": (("tool_mass",), False),
    "two_hands": (("other",), True),
}


def read_world(name: str, options: dict[str, Any]) -> tuple[WorldKind, bool]:
    """Return a kind of world and whether any hand is meant; raises ValueError for a name or options that do not fit."""
    if name not in NAMES:
        raise ValueError(f"world = {name!r}: expected one of {', '.join(NAMES)}")
    needed, any_hand = NAMES[name]
    if set(options) != set(needed):
        wanted = ", ".join(needed) or "no option"
        raise ValueError(f"world = {name!r}: expected {wanted}, found {', '.join(sorted(options)) or 'none'}")
    if name == "spring":
        low, high = options["springs"]
        return Springs(float(low), float(high)), any_hand
    if name in ("tool", "any_hand_tool"):
        return SteppedTool(float(options["tool_damping"])), any_hand
    if name == "euler_tool":
        return EulerTool(float(options["tool_mass"])), any_hand
    if name == "two_hands":
        other: Plant = options["other"]
        return OtherDevice(other.damping, other.delay), any_hand
    return (Wall() if name.endswith("wall") else AnyWorld()), any_hand
