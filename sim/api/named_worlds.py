"""Kinds of world by name, as `haptic.k_max` reads them."""

from __future__ import annotations

from typing import Any

from nodes.stability.plant import Plant
from nodes.stability.worlds import (
    AnyWorld,
    EulerTool,
    OtherDevice,
    Springs,
    SteppedTool,
    Wall,
    WorldKind,
)

# World name to its options, and whether any hand may hold the device.
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
    """Return a kind of world, and whether any hand may hold the device.

    Raises ValueError for an unknown name and for options that the world does not have.
    """
    if name not in NAMES:
        raise ValueError(f"world = {name!r}: expected one of {', '.join(NAMES)}")
    needed, any_hand = NAMES[name]
    if set(options) != set(needed):
        wanted = ", ".join(needed) or "no option"
        raise ValueError(
            f"world = {name!r}: expected {wanted}, found {', '.join(sorted(options)) or 'none'}"
        )
    if name == "spring":
        low, high = _numbers("springs", options["springs"], 2)
        return Springs(low, high), any_hand
    if name in ("tool", "any_hand_tool"):
        (damping,) = _numbers("tool_damping", options["tool_damping"])
        return SteppedTool(damping), any_hand
    if name == "euler_tool":
        (mass,) = _numbers("tool_mass", options["tool_mass"])
        return EulerTool(mass), any_hand
    if name == "two_hands":
        other = options["other"]
        if not isinstance(other, Plant):
            raise ValueError(f"other = {other!r}: expected a Plant, the second device")
        return OtherDevice(other.damping, other.delay), any_hand
    return (Wall() if name.endswith("wall") else AnyWorld()), any_hand


def _numbers(name: str, value: Any, count: int = 1) -> list[float]:
    """Return an option's numbers; ValueError unless there are `count` of them."""
    given = list(value) if isinstance(value, list | tuple) and count > 1 else [value]
    if len(given) != count or not all(
        isinstance(one, int | float) or hasattr(one, "__float__") for one in given
    ):
        raise ValueError(
            f"{name} = {value!r}: expected {'a number' if count == 1 else f'{count} numbers'}"
        )
    return [float(one) for one in given]
