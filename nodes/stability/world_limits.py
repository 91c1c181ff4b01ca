"""Largest stiffness of a law for each kind of world, and the damping it needs there."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from nodes.laws import CompiledLaw
from nodes.stability.needed import (
    needed_device_damping,
    needed_tool_damping,
    needed_tool_mass,
)
from nodes.stability.plant import Plant
from nodes.stability.worlds import (
    AnyWorld,
    EulerTool,
    OtherDevice,
    Springs,
    SteppedTool,
    Wall,
    WorldKind,
    hand_text,
    world_k_max,
)
from nodes.stability.worst_world import WorstWorld, worst_world

# a rigid spring: the wall's edge without scipy, which takes half a second to import
_WALL = Springs(math.inf, math.inf)


@dataclass(frozen=True)
class Moving:
    """Moving worlds to check besides a wall and any implicit world."""

    springs: tuple[float, float] | None = None  # softest and stiffest spring [N/m]
    tool_damping: float | None = None  # of a stepped tool to ground [N s/m]
    tool_mass: float | None = None  # of a tool moved by semi-implicit Euler [kg]
    other: OtherDevice | None = None  # a second device, any hands on both

    def asked(self) -> dict[str, tuple[WorldKind, bool]]:
        """Return worlds, and whether any hand is allowed, by the name of their figure."""
        found: dict[str, tuple[WorldKind, bool]] = {
            "wall": (_WALL, False),
            "any_world": (AnyWorld(), False),
            "any_hand_any_world": (AnyWorld(), True),
        }
        if self.springs is not None:
            found["springs"] = (Springs(*self.springs), False)
        if self.tool_damping is not None:
            found["tool_any_world"] = (SteppedTool(self.tool_damping), False)
            found["any_hand_tool_any_world"] = (SteppedTool(self.tool_damping), True)
        if self.tool_mass is not None:
            found["euler_tool_any_world"] = (EulerTool(self.tool_mass), False)
        if self.other is not None:
            found["two_hands"] = (self.other, True)
        return found


@dataclass(frozen=True)
class WorldLimits:
    """Largest nominal stiffness per kind of world; None: none is certified, infinite: all are."""

    k_max_n_per_m: Mapping[str, float | None]
    about: Mapping[str, str]  # worlds and hands of each figure
    worst_world: WorstWorld | None = None  # at the edge of ``any_world``
    # of `about` the worlds alone
    worlds: Mapping[str, str] = field(default_factory=dict)

    def as_json(self) -> dict[str, object]:
        """Return the figures with units in their keys; null: none certified, or unlimited."""
        found: dict[str, object] = {
            f"k_max_{name}_n_per_m": finite(k) for name, k in self.k_max_n_per_m.items()
        }
        worst = self.worst_world
        found["worst_world"] = None
        if worst is not None:
            keys = (
                "mass_kg",
                "stiffness_n_per_m",
                "damping_n_s_per_m",
                "frequency_hz",
                "integrator",
            )
            found["worst_world"] = {key: getattr(worst, key) for key in keys}
        return found | {"about": dict(self.about), "unlimited": self.unlimited}

    @property
    def unlimited(self) -> list[str]:
        """Names of the worlds for which every stiffness is certified."""
        return [name for name, k in self.k_max_n_per_m.items() if k == math.inf]


def finite(value: float | None) -> float | None:
    """Return a finite value, else None."""
    return value if value is not None and math.isfinite(value) else None


def world_limits(
    derivative: CompiledLaw,
    plant: Plant,
    moving: Moving | None = None,
    worst: bool = False,
) -> WorldLimits:
    """Return the largest stiffness of a law for each kind of world.

    Parameters
    ----------
    derivative : CompiledLaw
        The law without its spring (`nodes.stability.k_max.without_spring`).
    plant : Plant
        The device and its loop.
    moving : Moving or None
        Worlds besides a wall, any implicit world, and any implicit world with any hand.
    worst : bool
        Whether to build the worst world as well.

    Raises
    ------
    ValueError
        For a law with own code, which has no transfer function.
    """
    found = {}
    about, worlds = {}, {}
    for name, (world, any_hand) in (moving or Moving()).asked().items():
        one = world_k_max(derivative, plant, world, any_hand)
        found[name] = one.k_max_n_per_m
        # A wall is a spring without an end, and named as what it is.
        worlds[name] = (Wall() if world is _WALL else world).about
        about[name] = f"{worlds[name]}; {hand_text(plant, any_hand)}"
    built = worst_world(derivative, plant) if worst else None
    return WorldLimits(found, about, built, worlds)


def world_needs(law: CompiledLaw, plant: Plant) -> dict[str, float | None]:
    """Return what a law needs for each kind of moving world; None: nothing is enough.

    ``device_damping_…`` of the device [N s/m], ``tool_damping_…`` of a stepped tool to ground [N
    s/m], ``tool_mass_…`` of a tool moved by semi-implicit Euler [kg].
    """
    return {
        "device_damping_any_world_n_s_per_m": needed_device_damping(
            law, plant, AnyWorld()
        ),
        "device_damping_any_hand_any_world_n_s_per_m": needed_device_damping(
            law, plant, AnyWorld(), any_hand=True
        ),
        "tool_damping_any_world_n_s_per_m": needed_tool_damping(law, plant),
        "tool_damping_any_hand_any_world_n_s_per_m": needed_tool_damping(
            law, plant, any_hand=True
        ),
        "tool_mass_euler_kg": needed_tool_mass(law, plant),
    }
