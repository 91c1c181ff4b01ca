"""Whether a law is certified for a launch's kind of world, and what would certify it."""

from __future__ import annotations

import math
from dataclasses import dataclass

from nodes.laws import CompiledLaw
from nodes.stability.k_max import with_spring
from nodes.stability.needed import (
    needed_device_damping,
    needed_tool_damping,
    needed_tool_mass,
)
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
    steps: int = 1  # steps of Euler a tick that this mass is for
    # the mass at one step a tick, where there are several; None: the same, or none is enough
    tool_mass_one_step_kg: float | None = None

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
                ("a mass of the tool", self.tool_mass_kg, self._mass_unit),
                ("damping of the device", self.device_damping_n_s_per_m, "N s/m"),
            )
            if value is not None
        ]
        remedy = f"; it takes {' or '.join(ways)}" if ways else ""
        if self.tool_mass_kg is None and self.tool_mass_one_step_kg is not None:
            needed = f"{self.tool_mass_one_step_kg:.3g} kg"
            remedy += f"; at one step a tick {needed} of the tool would do"
        return (
            f"not certified with {self.about}: {limit}, and it has {self.h1_n_per_m:.4g}"
            f" N/m{remedy}"
        )

    @property
    def _mass_unit(self) -> str:
        """The unit of a mass, and which scenes and steps it is for."""
        one = self.tool_mass_one_step_kg
        fewer = "" if one is None else f"; {one:.3g} kg at one step a tick"
        return (
            f"kg ({self.steps} steps of Euler a tick{fewer})"
            if self.steps > 1
            else "kg"
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
    tool_damping = tool_mass = one_step = device_damping = None
    steps = 1
    if not holds:
        if isinstance(world, SteppedTool):
            tool_damping = needed_tool_damping(law, plant, any_hand, world.delay)
            late = plant.delay if world.delay is None else world.delay
            if world.steps is not None:
                steps = world.steps
                tool_mass, one_step = _masses(law, plant, any_hand, steps, late)
        elif isinstance(world, EulerTool):
            steps = world.steps
            tool_mass, one_step = _masses(law, plant, any_hand, steps, world.delay)
        if not isinstance(world, Wall | OtherDevice) or any_hand:
            device_damping = needed_device_damping(law, plant, world, any_hand)
    return WorldVerdict(
        holds,
        about,
        law.h1,
        high,
        device_damping,
        tool_damping,
        tool_mass,
        steps,
        one_step,
    )


def judge_tool(
    law: CompiledLaw,
    plant: Plant,
    tool: SteppedTool,
    mass: float | None,
    any_hand: bool = False,
) -> WorldVerdict | None:
    """Judge a law on a stepped tool by its damping, and by its mass if that is too little.

    Parameters
    ----------
    law : CompiledLaw
        The law as it renders.
    plant : Plant
        The device itself and its loop.
    tool : SteppedTool
        The tool; its steps are known where all behind it is solved within them.
    mass : float or None
        Mass of the tool [kg].
    any_hand : bool
        Whether every passive hand may hold the device.
    """
    damped = judge_world(law, plant, tool, any_hand)
    if damped is None or damped.certified or mass is None or tool.steps is None:
        return damped
    late = plant.delay if tool.delay is None else tool.delay
    heavy = judge_world(
        law, plant, EulerTool(mass, tool.steps, tool.damping, late), any_hand
    )
    return heavy if heavy is not None and heavy.certified else damped


def _masses(
    law: CompiledLaw, plant: Plant, any_hand: bool, steps: int, delay: float
) -> tuple[float | None, float | None]:
    """Return a tool's least mass at its Euler steps a tick, and at one step [kg]."""
    mass = needed_tool_mass(law, plant, any_hand, steps, delay)
    one = needed_tool_mass(law, plant, any_hand, 1, delay) if steps > 1 else None
    return mass, one
