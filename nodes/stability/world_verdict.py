"""Whether a law is certified for a launch's kind of world, and what would certify it."""

from __future__ import annotations

import math
from dataclasses import dataclass

from nodes.laws import CompiledLaw
from nodes.stability.k_max import with_spring
from nodes.stability.needed import needed_device_damping, needed_tool_damping, needed_tool_mass
from nodes.stability.plant import Plant
from nodes.stability.worlds import (
    EulerTool,
    OtherDevice,
    SteppedTool,
    Wall,
    WorldKind,
    hand_text,
    world_k_max,
)


@dataclass(frozen=True)
class WorldVerdict:
    """Certificate of a law for every world of one kind."""

    certified: bool
    about: str  # worlds and hands of the certificate
    h1_n_per_m: float  # stiffness of the law, H(1) [N/m]
    # largest certified H(1) of this law [N/m]; None: none
    h1_max_n_per_m: float | None
    # least damping of the device with which the law is certified; None: none
    device_damping_n_s_per_m: float | None
    # least damping of a stepped tool; None for other worlds, or if none is enough
    tool_damping_n_s_per_m: float | None
    # least mass of a semi-implicit Euler tool; None for other worlds, or if none is enough
    tool_mass_kg: float | None

    @property
    def text(self) -> str:
        """Verdict in one sentence, with remedies."""
        limit = (
            "no stiffness"
            if self.h1_max_n_per_m is None
            else f"H(1) up to {self.h1_max_n_per_m:.4g} N/m"
        )
        if self.h1_max_n_per_m == math.inf:
            limit = "every stiffness"
        if self.certified:
            return f"certified with {self.about}: {limit}; it has {self.h1_n_per_m:.4g} N/m"
        ways = [
            f"{what} of at least {value:.3g} {unit}"
            for what, value, unit in (
                ("damping of the tool", self.tool_damping_n_s_per_m, "N s/m"),
                ("a mass of the tool", self.tool_mass_kg, "kg"),
                ("damping of the device", self.device_damping_n_s_per_m, "N s/m"),
            )
            if value is not None
        ]
        remedy = f"; it takes {' or '.join(ways)}" if ways else ""
        return (
            f"not certified with {self.about}: {limit}, and it has {self.h1_n_per_m:.4g}"
            f" N/m{remedy}"
        )


def judge_world(
    law: CompiledLaw, plant: Plant, world: WorldKind, any_hand: bool = False
) -> WorldVerdict | None:
    """Return the verdict on a law for every world of a kind; None for a law with own code.

    Parameters
    ----------
    law : CompiledLaw
        The law as it renders.
    plant : Plant
        The device itself and its loop (no tool included in its mass).
    world : WorldKind
        `SteppedTool` for a body that is stepped with the force held (kind ``mujoco``), its damping
        as measured or declared; `EulerTool`, `OtherDevice`, `AnyWorld`, `Springs` or `Wall`.
    any_hand : bool
        Whether every passive hand may hold the device; else the hand is that of the plant.
    """
    if law.evaluate is not None:
        return None
    edge = world_k_max(with_spring(law, -law.h1), plant, world, any_hand)
    low, high = edge.low_n_per_m, edge.k_max_n_per_m
    holds = low is not None and high is not None and low < law.h1 < high
    about = f"{world.about}; {hand_text(plant, any_hand)}"
    tool_damping = tool_mass = device_damping = None
    if not holds:
        if isinstance(world, SteppedTool):
            tool_damping = needed_tool_damping(law, plant, any_hand, world.delay)
        elif isinstance(world, EulerTool):
            tool_mass = needed_tool_mass(law, plant, any_hand)
        if not isinstance(world, Wall | OtherDevice) or any_hand:
            device_damping = needed_device_damping(law, plant, world, any_hand)
    return WorldVerdict(holds, about, law.h1, high, device_damping, tool_damping, tool_mass)
