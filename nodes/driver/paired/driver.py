"""Two devices coupled position to position: one law between two hands.

The position of the pair is that of the first device minus that of the second; a force on the pair
acts on the first, and its opposite on the second. So the law's deflection is the distance of the
hands, and everything that holds for one device holds for the pair: history, changes of law, limits,
and energy, because F·(v₁ − v₂) is the power on both. The stability figures use the second device as
the `partner` of the coupling's `plant` (nodes/stability/pair.py).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from typing import Annotated, Any, ClassVar

import msgspec

from nodes.base.node_kinds import load, node_kinds
from nodes.base.setup import Axis, Setup
from nodes.driver.device import Device, DeviceLimits
from nodes.driver.limits import SafetyParameters, lower, undeclared
from nodes.driver.node import Driver
from nodes.driver.paired.paired_device import Alignment, PairedDevice
from nodes.driver.parameters import DriverParameters
from nodes.parameters.store import ParameterError, convert


class PairedMember(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True
):
    """One device of the pair.

    kind: Kind of driver.
    parameters: Parameters of that driver. Of its ``safety``, forces, slew and workspace apply; the
        rest is the pair's.
    """

    kind: str
    parameters: dict[str, Any] = {}


class PairedDriverParameters(
    DriverParameters, frozen=True, forbid_unknown_fields=True, kw_only=True
):
    """Parameters of the driver of a pair.

    first, second: The devices.
    align: Speed at which an initial distance of the devices, or one after a gap, is closed [m/s]:
        it counts as zero at first, and this offset decreases. 0 keeps the offset for ever.
    apart: Largest initial distance along an axis [m]; the driver refuses to start beyond it. None
        for any.
    """

    first: PairedMember
    second: PairedMember
    align: Annotated[float, msgspec.Meta(ge=0.0, le=1.0)] = 0.05
    apart: Annotated[float, msgspec.Meta(gt=0.0)] | None = None


class PairedDriver(Driver):
    """A driver node with two devices."""

    Parameters: ClassVar[type[msgspec.Struct]] = PairedDriverParameters

    @classmethod
    def check(cls, setup: Setup) -> None:
        """Check the pair, and each device as a driver of its own, before the launch."""
        super().check(setup)
        for kind, own in _members(setup):
            kind.check(own)

    @classmethod
    def substitute_device(
        cls, parameters: Mapping[str, Any], name: str, device: str
    ) -> tuple[dict[str, Any], dict[str, Any]] | None:
        """Replace both devices by a preset, if they are virtual."""
        changed = dict(parameters)
        plants = []
        for which, member in _both(convert(parameters, PairedDriverParameters, name)):
            stood = _kind_of(member, f"{name}.{which}")[1].substitute_device(
                member.parameters, f"{name}.{which}", device
            )
            if stood is None:
                return None
            changed[which] = {"kind": member.kind, "parameters": stood[0]}
            plants.append(stood[1])
        return changed, {"heaviest": None, **_pair(*plants)}

    @classmethod
    def plant(
        cls, parameters: Mapping[str, Any], name: str, axes: Sequence[Axis]
    ) -> dict[str, float]:
        """Return the plant of two known devices with their hands, or the scale of two real ones."""
        known = []
        for which, member in _both(convert(parameters, PairedDriverParameters, name)):
            where = f"{name}.{which}"
            known.append(
                _kind_of(member, where)[1].plant(member.parameters, where, axes)
            )
        if not all("mass" in one for one in known):
            scales = {one.get("scale", 1.0) for one in known}
            return {"scale": scales.pop()} if len(scales) == 1 else {}
        plant = _pair(*known)
        lightest = known[0]["mass"]
        heaviest = known[0].get("heaviest", lightest)
        if heaviest > lightest:
            plant["heaviest"] = heaviest
        return plant

    @classmethod
    def is_virtual(cls, parameters: Mapping[str, Any], name: str) -> bool:
        """Return whether both devices live in simulated time."""
        return all(
            _kind_of(member, f"{name}.{which}")[1].is_virtual(
                member.parameters, f"{name}.{which}"
            )
            for which, member in _both(
                convert(parameters, PairedDriverParameters, name)
            )
        )

    @classmethod
    def largest_force(
        cls, parameters: Mapping[str, Any], name: str, period: float
    ) -> float | None:
        """Return the lowest of the pair's and the devices' limits [N]."""
        known = [super().largest_force(parameters, name, period)]
        for which, member in _both(convert(parameters, PairedDriverParameters, name)):
            kind = _kind_of(member, f"{name}.{which}")[1]
            known.append(
                kind.largest_force(member.parameters, f"{name}.{which}", period)
            )
        return min((peak for peak in known if peak is not None), default=None)

    def make_device(self) -> Device:
        """Connect both, forces off."""
        self._drivers = [kind(own) for kind, own in _members(self.setup)]
        with ExitStack() as held:
            made = []
            for driver in self._drivers:
                made.append(driver.make_device())
                held.callback(made[-1].close)
            limits = [
                self._limits_of(driver, device)
                for driver, device in zip(self._drivers, made, strict=True)
            ]
            held.pop_all()
        wanted: PairedDriverParameters = self.store.current
        alignment = Alignment(
            step=wanted.align * self.setup.period,
            apart=math.inf if wanted.apart is None else wanted.apart,
        )
        self.pair = PairedDevice(made[0], made[1], limits, alignment)
        for _, device in self._hardware():
            device.come_back_within(self.store.current.safety)
        return self.pair

    def _limits_of(self, driver: Driver, device: Device) -> DeviceLimits:
        """Return a device's limits lowered by its own parameters.

        Raises ParameterError if a real device does not declare the required limits.
        """
        name = driver.setup.name
        own = driver.store.current.safety
        period = self.setup.period
        pair: SafetyParameters = self.store.current.safety
        # each device gets the force of the pair
        peak = own.peak_force if own.peak_force is not None else pair.peak_force
        declared = msgspec.structs.replace(
            own, peak_force=peak, without=[*own.without, *pair.without]
        )
        if not driver.virtual and (refusal := undeclared(declared, device.limits)):
            raise ParameterError(refusal, path=name)
        found = lower(own, device.limits, period, f"{name}.safety")
        for text in found.overruled:
            self.events.emit_each("limit", text)
        return msgspec.structs.replace(
            device.limits,
            peak_force=math.inf if found.peak is None else found.peak,
            continuous_force=math.inf if found.continuous is None else found.continuous,
            slew=math.inf if found.slew is None else found.slew / period,
            workspace=found.workspace,
        )

    def operations(self) -> dict[str, Any]:
        """Return the operations, with the position of each device."""
        return {
            **super().operations(),
            "places": lambda: {
                "first_m": self.pair.places[0],
                "second_m": self.pair.places[1],
            },
        }

    def check_health(self) -> None:
        """Check health, and report devices that are brought together (control thread)."""
        super().check_health()
        met = self.pair.met_apart
        self.pair.met_apart = 0.0
        if met > 0.0:
            speed = self.store.current.align
            how = (
                f"are brought together at {speed:g} m/s"
                if speed > 0.0
                else "keep that offset"
            )
            text = f"the devices stand {met:.4g} m apart without a motion, and {how}"
            self.events.emit_each(
                "device", text, {"apart_m": met, "align_m_per_s": speed}
            )

    def condition(self) -> str:
        """Return which device gives no forces, and why."""
        facts = ((name, device.condition()) for name, device in self._hardware())
        told = (f"{name}: {condition}" for name, condition in facts if condition)
        return "; ".join(filter(None, (self.pair.outside(), *told)))

    def _hardware(self) -> list[tuple[str, Any]]:
        from nodes.driver.hardware.mailbox import MailboxDevice

        pair = (("first", self.pair.first), ("second", self.pair.second))
        return [
            (name, device) for name, device in pair if isinstance(device, MailboxDevice)
        ]


def _pair(first: Mapping[str, float], second: Mapping[str, float]) -> dict[str, float]:
    """Return the plant of two devices' coupling: the first, with the second as its partner."""
    own = ("mass", "damping", "stiffness")
    found = {name: first[name] for name in (*own, "device_delay")} | {
        f"partner_{name}": second[name] for name in own
    }
    return {**found, "partner_later": second["device_delay"] - first["device_delay"]}


def _both(
    parameters: PairedDriverParameters,
) -> tuple[tuple[str, PairedMember], tuple[str, PairedMember]]:
    return ("first", parameters.first), ("second", parameters.second)


def _kind_of(member: PairedMember, where: str) -> tuple[str, type[Driver]]:
    """Return factory and class of a device's driver."""
    factory = node_kinds().get(member.kind)
    if factory is None:
        raise ParameterError(
            f"{member.kind!r} is no installed kind of driver", path=f"{where}.kind"
        )
    kind = load(factory)
    if not issubclass(kind, Driver) or issubclass(kind, PairedDriver):
        raise ParameterError(
            f"{member.kind!r} drives no single device", path=f"{where}.kind"
        )
    return factory, kind


def _members(setup: Setup) -> Iterator[tuple[type[Driver], Setup]]:
    """Yield each device's driver, and its setup as a node of its own."""
    for which, member in _both(
        convert(setup.parameters, PairedDriverParameters, setup.name)
    ):
        where = f"{setup.name}.{which}"
        factory, kind = _kind_of(member, where)
        changed: dict[str, Any] = {
            "name": where,
            "kind": member.kind,
            "parameters": member.parameters,
        }
        # both are called through Python
        yield (
            kind,
            msgspec.structs.replace(setup, factory=factory, tick="plain", **changed),
        )
