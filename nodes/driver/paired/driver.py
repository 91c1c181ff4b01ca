"""Two devices coupled position to position: one law between two hands.

The position of the pair is that of the first device less that of the second; a force on the pair acts on the first, and its
opposite on the second. So the deflection of the law is how far the hands are apart, and everything that holds for one device
holds for the pair: history, swaps, limits, and energy, because F·(v₁ − v₂) is the power on both. Two equal devices of mass m
and damping b are to the law one of m/2 and b/2, which is the `plant` of its stability figures (`Plant.paired_with`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from typing import Any, ClassVar

import msgspec

from messages.types import Vector
from nodes.base.node_kinds import load, node_kinds
from nodes.base.setup import Setup
from nodes.driver.device import Device, DeviceLimits, Workspace
from nodes.driver.node import Driver
from nodes.driver.parameters import DriverParameters
from nodes.parameters.store import ParameterError, convert
from nodes.stability.plant import Plant


class PairedMember(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One of the two.

    kind: Kind of driver.
    parameters: As that driver takes them.
    """

    kind: str
    parameters: dict[str, Any] = {}


class PairedDriverParameters(DriverParameters, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Parameters of the driver of a pair.

    first, second: The devices.
    """

    first: PairedMember
    second: PairedMember


class PairedDevice:
    """Two devices as one."""

    def __init__(self, first: Device, second: Device) -> None:
        self.first, self.second = first, second
        self.places: tuple[Vector, Vector] = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))

    @property
    def limits(self) -> DeviceLimits:
        """The lower of each limit; of the workspaces, all that one position less another can be."""
        a, b = self.first.limits, self.second.limits
        x, y, z = ((p[0] - q[1], p[1] - q[0]) for p, q in zip(a.workspace, b.workspace, strict=True))
        workspace: Workspace = (x, y, z)
        known = None not in (a.latency, b.latency)
        return DeviceLimits(
            peak_force=min(a.peak_force, b.peak_force),
            continuous_force=min(a.continuous_force, b.continuous_force),
            slew=min(a.slew, b.slew),
            silence=min(a.silence, b.silence),
            hold=max(a.hold, b.hold),
            latency=max(a.latency or 0.0, b.latency or 0.0) if known else None,
            opening=a.opening + b.opening,
            closing=a.closing + b.closing,
            workspace=workspace,
        )

    def open(self) -> None:
        """Open both, or none."""
        with ExitStack() as opened:
            for device in (self.first, self.second):
                opened.callback(device.close)
                device.open()
            opened.pop_all()

    def read_position(self, seq: int) -> Vector:
        """Tell how far they are apart; unknown where one of them is."""
        a, b = self.first.read_position(seq), self.second.read_position(seq)
        self.places = a, b
        return a[0] - b[0], a[1] - b[1], a[2] - b[2]

    def write_force(self, force: Vector, seq: int, offset: float) -> None:
        """Push the first, and the second the other way; where one does not know its place, neither."""
        if not all(math.isfinite(x) for place in self.places for x in place):
            force = (0.0, 0.0, 0.0)
        x, y, z = force
        self.first.write_force(force, seq, offset)
        self.second.write_force((-x, -y, -z), seq, offset)

    def close(self) -> None:
        """Close both, whatever becomes of the first."""
        try:
            self.first.close()
        finally:
            self.second.close()


class PairedDriver(Driver):
    """A driver node with two devices."""

    Parameters: ClassVar[type[msgspec.Struct]] = PairedDriverParameters

    @classmethod
    def check(cls, setup: Setup) -> None:
        """Check the pair, and each of the two as a driver of its own, before anything is started."""
        super().check(setup)
        for kind, own in _members(setup):
            kind.check(own)

    @classmethod
    def substitute_device(
        cls, parameters: Mapping[str, Any], name: str, device: str
    ) -> tuple[dict[str, Any], dict[str, Any]] | None:
        """Put a preset in the place of both devices, where they are virtual ones."""
        changed, plants = dict(parameters), []
        for which, member in _both(convert(parameters, PairedDriverParameters, name)):
            stood = _kind_of(member, f"{name}.{which}")[1].substitute_device(member.parameters, f"{name}.{which}", device)
            if stood is None:
                return None
            changed[which] = {"kind": member.kind, "parameters": stood[0]}
            plants.append(stood[1])
        first, second = (Plant(1.0, one["mass"], one["damping"], one["device_delay"], one["stiffness"]) for one in plants)
        pair = first.paired_with(second)
        facts = {"mass": pair.mass, "damping": pair.damping, "stiffness": pair.stiffness, "device_delay": pair.delay}
        return changed, {"heaviest": None, **facts}

    def make_device(self) -> Device:
        """Take hold of both, forces off."""
        self._drivers = [kind(own) for kind, own in _members(self.setup)]
        with ExitStack() as held:
            made = []
            for driver in self._drivers:
                made.append(driver.make_device())
                held.callback(made[-1].close)
            held.pop_all()
        self.pair = PairedDevice(*made)
        return self.pair

    def operations(self) -> dict[str, Any]:
        """Offer where each of the two is."""
        return {**super().operations(), "places": lambda: {"first_m": self.pair.places[0], "second_m": self.pair.places[1]}}

    def condition(self) -> str:
        """Say which of them keeps forces off, and why."""
        facts = ((name, device.condition()) for name, device in self._hardware())
        return "; ".join(f"{name}: {condition}" for name, condition in facts if condition)

    def _hardware(self) -> list[tuple[str, Any]]:
        from nodes.driver.hardware.mailbox import MailboxDevice

        pair = (("first", self.pair.first), ("second", self.pair.second))
        return [(name, device) for name, device in pair if isinstance(device, MailboxDevice)]


def _both(parameters: PairedDriverParameters) -> tuple[tuple[str, PairedMember], tuple[str, PairedMember]]:
    return ("first", parameters.first), ("second", parameters.second)


def _kind_of(member: PairedMember, where: str) -> tuple[str, type[Driver]]:
    """Find the driver of one of the two: where its class is, and the class."""
    factory = node_kinds().get(member.kind)
    if factory is None:
        raise ParameterError(f"{where}.kind: {member.kind!r} is no installed kind of driver")
    kind = load(factory)
    if not issubclass(kind, Driver) or issubclass(kind, PairedDriver):
        raise ParameterError(f"{where}.kind: {member.kind!r} drives no single device")
    return factory, kind


def _members(setup: Setup) -> Iterator[tuple[type[Driver], Setup]]:
    """Give for each of the two its driver, and the setup that it has as a node of its own."""
    for which, member in _both(convert(setup.parameters, PairedDriverParameters, setup.name)):
        where = f"{setup.name}.{which}"
        factory, kind = _kind_of(member, where)
        changed: dict[str, Any] = {"name": where, "kind": member.kind, "parameters": member.parameters}
        # Each is called as one that is written in Python.
        yield kind, msgspec.structs.replace(setup, factory=factory, tick="plain", **changed)
