"""The parameters of the coupling node: named laws, the active one, contact conventions, fallback, stability policy."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import msgspec

from nodes.laws import CompiledLaw
from nodes.parameters.checked import NonNegative, Positive
from nodes.stability.plant import Counterpart, Plant

LawName = Annotated[str, msgspec.Meta(pattern=r"^[A-Za-z][A-Za-z0-9_-]{0,63}$")]
"""A law's name is part of paths (laws.NAME.stiffness) and travels with every force."""


class Swap(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A swap that the launch file schedules.

    at: Time since tick 0 [s].
    law: Name of the law.
    ramp: Cross-fade [ticks], 0 for a hard swap.
    """

    at: NonNegative
    law: str
    ramp: Annotated[int, msgspec.Meta(ge=0, le=100_000)] = 0


class Fallback(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What renders when a law fails.

    damping: Damper on the deflection [N s/m]; 0 renders no force.
    """

    damping: NonNegative = 0.0

    def compile(self, period: float) -> CompiledLaw:
        """Turn it into taps."""
        return CompiledLaw((self.damping / period, -self.damping / period))


# longest delay that a law is judged at [ticks]: the closed loop has one more state for each
LONGEST_DELAY = 100.0

Delay = Annotated[float, msgspec.Meta(ge=0.0, le=LONGEST_DELAY)]

MASSES = 9  # with so many masses a law is judged where the mass depends on the position


class PlantParameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The device that a law's pole radius is computed for.

    mass: m [kg].
    damping: b [N s/m].
    stiffness: Stiffness of the hand [N/m].
    delay: Delay of the loop [ticks]; None for the measured one.
    device_delay: Delay of the device itself, which the loop cannot measure: comes on top of the
        measured one [ticks].
    heaviest: The greatest mass where it depends on where the device is, and ``mass`` is the least:
        a law is judged with both and with some between [kg].
    tool_mass: Mass of what the coupling holds the device to, where that moves (kind ``mujoco``)
        [kg]; None for a wall.
    tool_damping: Viscous damping of that to ground [N s/m].
    tool_stiffness: Stiffness of a spring from that to ground [N/m].
    tool_lag: How much later than a tick's force the other end of the coupling answers: 0 in the
        same tick, whatever it is, and above 0 for a tool that is stepped [ticks]; None for a wall,
        or a tool that is stepped.
    partner_mass: Mass of the other device, where two are coupled position to position [kg]; None
        for one.
    partner_damping: Its damping [N s/m].
    partner_stiffness: Stiffness of its hand [N/m].
    partner_later: How much later forces act on it than on the first; negative for earlier [ticks].
    scale: Metres of the scene for a metre of the device (``mapping.scale`` of a driver). Mass,
        damping and stiffness above are the device's own; a law meets them divided by the square of
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
    tool_lag: Annotated[float, msgspec.Meta(ge=0.0, le=1.0)] | None = None
    partner_mass: Positive | None = None
    partner_damping: NonNegative = 0.0
    partner_stiffness: NonNegative = 0.0
    partner_later: Annotated[float, msgspec.Meta(ge=-100.0, le=100.0)] = 0.0
    scale: Annotated[float, msgspec.Meta(ge=0.01, le=100.0)] = 1.0

    def at(self, period: float, measured: float) -> Plant:
        """Return the device in a loop of a `period` [s] and a `measured` delay [ticks], as a law is judged on it."""
        delay = (measured if self.delay is None else self.delay) + self.device_delay
        # a force F of the scene is s F on the device, which moves 1/s as far
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
            # The tool is pushed when the loop hands the force over: what the device adds to the
            # delay is its own.
            partner = Counterpart(
                self.tool_mass, self.tool_damping, self.tool_stiffness, -self.device_delay
            )
        return Plant(
            period, self.mass / felt, self.damping / felt, delay, self.stiffness / felt, partner
        )

    @property
    def masses(self) -> list[float]:
        """The masses that a law is judged with [kg], in equal ratios: between both a loop may die down more slowly."""
        if self.heaviest is None:
            return [self.mass]
        between = [
            self.mass * (self.heaviest / self.mass) ** (k / (MASSES - 1))
            for k in range(1, MASSES - 1)
        ]
        return [self.mass, *between, self.heaviest]

    def over_workspace(self, period: float, measured: float) -> list[Plant]:
        """Give it with each of its masses."""
        return [
            msgspec.structs.replace(self, mass=mass).at(period, measured) for mass in self.masses
        ]


class CouplingParameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Parameters of the coupling.

    law: Name of the active law: one of `laws`, a preset, or an installed kind.
    laws: Named laws, each with its ``kind`` and parameters (see nodes/laws/), or the bare name of a
        preset. A name is letters, digits, _ and -, at most 64.
    usual: What a law that is not among `laws` (a preset, or any installed kind) is made with, where
        it has such parameters.
    history: What feeds the laws outside contact: ``penetration`` (zero) or ``position`` (the raw
        distance).
    frame: Axes in which the history keeps deflections: ``world``; ``surface``, which turn with the
        normal while it turns steadily, so that a law feels nothing of the way itself (THEORY.md
        §15); or ``auto``, the latter where all three are computed.
    clamp: Whether a force into the wall is set to zero.
    memory: Ticks of deflection that are kept; bounds the longest law.
    ramp: Cross-fade of swaps that do not ask for another [ticks].
    ease: Time in which the force goes from what was felt to what is asked where the device begins
        in contact, or position, surface or proxy jump without motion [s]; 0 for at once.
    schedule: Swaps at given times.
    fallback: What renders when a law fails.
    budget: Part of the period that a law's own code may take.
    stability: What to do about a pole radius ≥ 1 with `plant`: ``refuse`` it; refuse ``changes``
        that lead there and a start on a real device, but warn of a start on a virtual one;
        ``warn``; or ``off``.
    plant: The device; None when it is not known.
    figures: Whether a switch is answered with the figures of both laws.
    """

    law: str
    laws: dict[LawName, Any] = {}
    usual: dict[str, bool | float | str | list[Any]] = {}
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
