"""Parameters of the coupling node: laws, contact conventions, fallback, stability policy."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

import msgspec

from nodes.coupling.force_fields import ForceField, NoField
from nodes.laws import CompiledLaw
from nodes.parameters.checked import NonNegative, Positive
from nodes.stability.plant import Counterpart, Plant

LawName = Annotated[str, msgspec.Meta(pattern=r"^[A-Za-z][A-Za-z0-9_-]{0,63}$")]
"""Name of a law: part of parameter paths (laws.NAME.stiffness), and sent with every force."""


class Swap(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A change of law scheduled in the launch file.

    at: Time since tick 0 [s].
    law: Name of the law.
    ramp: Cross-fade [ticks]; 0 for an immediate change.
    """

    at: NonNegative
    law: str
    ramp: Annotated[int, msgspec.Meta(ge=0, le=100_000)] = 0


class Fallback(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Law that renders when another one fails.

    damping: Damper on the deflection [N s/m]; 0 renders no force.
    """

    damping: NonNegative = 0.0

    def compile(self, period: float) -> CompiledLaw:
        """Return the taps."""
        return CompiledLaw((self.damping / period, -self.damping / period))


# longest delay at which a law is judged [ticks]: the closed loop has one more state for each
LONGEST_DELAY = 100.0

Delay = Annotated[float, msgspec.Meta(ge=0.0, le=LONGEST_DELAY)]

MASSES = 9  # masses at which a law is judged if the mass depends on the position


class PlantParameters(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True
):
    """The device on which laws are judged.

    mass: m [kg].
    damping: b [N s/m].
    stiffness: Stiffness of the hand [N/m].
    delay: Delay of the loop [ticks]; None for the measured one.
    device_delay: Delay of the device itself, which the loop cannot measure; added to the loop's
        [ticks].
    heaviest: Largest mass if the mass depends on the device's position, ``mass`` being the least; a
        law is judged with both and with some between [kg].
    tool_mass: Mass of the body that the coupling connects to the device, if that moves (kind
        ``mujoco``) [kg]; None for a wall.
    tool_damping: Viscous damping of that body to ground [N s/m].
    tool_stiffness: Stiffness of a spring from that body to ground [N/m].
    tool_step: Longest step of semi-implicit Euler that moves it, all that it touches solved within
        the step [s]; None if it is not. With it the mass of a tool certifies a law as well.
    tool_lag: Lag of the other end of the coupling: 0 if it answers in the same tick, above 0 for a
        stepped tool [ticks]; None for a wall, or a stepped tool of unknown lag.
    partner_mass: Mass of the second device, if two are coupled position to position [kg]; None for
        one device.
    partner_damping: Damping of the second device [N s/m].
    partner_stiffness: Stiffness of its hand [N/m].
    partner_later: Delay of the force on it relative to the first; negative for earlier [ticks].
    scale: Metres of the scene per metre of the device (``mapping.scale`` of a driver). Mass,
        damping and stiffness above are the device's own; a law feels them divided by the square of
        it.
    """

    mass: Positive
    damping: NonNegative = 0.0
    stiffness: NonNegative = 0.0
    delay: Delay | None = None
    device_delay: Delay = 0.0
    heaviest: Positive | None = None
    tool_mass: Positive | None = None
    tool_damping: NonNegative = 0.0
    tool_stiffness: NonNegative = 0.0
    tool_step: Positive | None = None
    tool_lag: Annotated[float, msgspec.Meta(ge=0.0, le=1.0)] | None = None
    partner_mass: Positive | None = None
    partner_damping: NonNegative = 0.0
    partner_stiffness: NonNegative = 0.0
    partner_later: Annotated[float, msgspec.Meta(ge=-100.0, le=100.0)] = 0.0
    scale: Annotated[float, msgspec.Meta(ge=0.01, le=100.0)] = 1.0

    def at(self, period: float, measured: float) -> Plant:
        """Return the device for judging laws, for a period [s] and a measured delay [ticks]."""
        delay = (measured if self.delay is None else self.delay) + self.device_delay
        # a force F in the scene is s F on the device, which moves 1/s as far
        felt = self.scale * self.scale
        partner = None
        if self.partner_mass is not None:
            body = (
                self.partner_mass / felt,
                self.partner_damping / felt,
                self.partner_stiffness / felt,
            )
            partner = Counterpart(*body, max(self.partner_later, -delay))
        elif self.tool_mass is not None and self.tool_lag != 0.0:
            # The tool is pushed when the loop delivers the force; the device's own delay does not
            # apply.
            partner = Counterpart(
                self.tool_mass,
                self.tool_damping,
                self.tool_stiffness,
                -self.device_delay,
            )
        return Plant(
            period,
            self.mass / felt,
            self.damping / felt,
            delay,
            self.stiffness / felt,
            partner,
        )

    def delay_before_device(self, loop: Plant) -> float:
        """Return the delay of a `loop` without the device's own [ticks]."""
        return max(loop.delay - self.device_delay, 0.0)

    def tool_steps(self, period: float) -> int | None:
        """Return in how many steps the scene is solved within a tick; None if not known."""
        if self.tool_step is None:
            return None
        # 1e-9: a quotient that is whole but for rounding
        return max(1, math.ceil(period / self.tool_step - 1e-9))

    @property
    def masses(self) -> list[float]:
        """Masses at which a law is judged [kg], in equal ratios; one between may be the worst."""
        if self.heaviest is None:
            return [self.mass]
        between = [
            self.mass * (self.heaviest / self.mass) ** (k / (MASSES - 1))
            for k in range(1, MASSES - 1)
        ]
        return [self.mass, *between, self.heaviest]

    def over_workspace(self, period: float, measured: float) -> list[Plant]:
        """Return the device with each of its masses."""
        return [
            msgspec.structs.replace(self, mass=mass).at(period, measured)
            for mass in self.masses
        ]


class CouplingParameters(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True
):
    """Parameters of the coupling.

    law: Name of the active law: one of `laws`, a preset, or an installed kind.
    laws: Named laws, each with its ``kind`` and parameters (see nodes/laws/), or the name of a
        preset. A name is letters, digits, _ and -, at most 64.
    usual: Default parameters of laws that are not among `laws` (presets and installed kinds), where
        they have such parameters.
    field: A force by formula, added to the law's everywhere: its ``kind`` (none, viscous, curl,
        constant, linear) and parameters (nodes/coupling/force_fields.py).
    history: Input of the laws outside contact: ``penetration`` (zero) or ``position`` (the raw
        distance).
    frame: Axes of the history: ``world``; ``surface``, which turn with the normal while it turns
        steadily, so that sliding along a curved surface is not felt as deflection (THEORY.md §15);
        or ``auto``, the latter if all three axes are computed.
    clamp: Whether a force into the wall is set to zero.
    memory: Ticks of deflection in the history; limits the longest law.
    ramp: Default cross-fade of law changes [ticks].
    ease: Time over which the force changes when the device begins in contact, or position, surface
        or proxy jump without motion [s]; 0 for at once.
    schedule: Changes of law at given times.
    fallback: Law that renders when another one fails.
    budget: Part of the period that a law's own code may take.
    stability: Policy for a pole radius ≥ 1 with `plant`: ``refuse`` it; refuse ``changes`` that
        lead there and a start on a real device, but warn of a start on a virtual one; ``warn``; or
        ``off``.
    plant: The device; None if unknown.
    figures: Whether a change is answered with the figures of both laws.
    """

    law: str
    laws: dict[LawName, Any] = {}
    usual: dict[str, bool | float | str | list[Any]] = {}
    field: ForceField = NoField()
    history: Literal["penetration", "position"] = "penetration"
    frame: Literal["auto", "world", "surface"] = "auto"
    clamp: bool = True
    memory: Annotated[int, msgspec.Meta(ge=2, le=1_000_000)] = 2048
    ramp: Annotated[int, msgspec.Meta(ge=0, le=100_000)] = 0
    ease: Annotated[float, msgspec.Meta(ge=0.0, le=10.0)] = 0.15
    schedule: list[Swap] = []
    fallback: Fallback = Fallback()
    budget: Annotated[float, msgspec.Meta(gt=0.0, le=1.0)] = 0.5
    stability: Literal["refuse", "changes", "warn", "off"] = "changes"
    plant: PlantParameters | None = None
    figures: bool = True
