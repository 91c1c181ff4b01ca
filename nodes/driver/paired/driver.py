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

from messages.types import ZERO, Vector
from nodes.base.node_kinds import load, node_kinds
from nodes.base.setup import Axis, Setup
from nodes.driver.calls import Jumps
from nodes.driver.device import Device, DeviceLimits, Workspace
from nodes.driver.limits import SafetyParameters, lower, undeclared
from nodes.driver.node import Driver
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


class Alignment(msgspec.Struct, frozen=True, kw_only=True):
    """How two devices with an initial distance are brought together.

    Attributes
    ----------
    step : float
        Decrease of their offset per tick [m].
    apart : float
        Largest initial distance along an axis [m].
    """

    step: float
    apart: float = math.inf


class PairedDevice:
    """Two devices as one; `limits` are those of each device, if lower than its own.

    With an `alignment` the pair begins at zero, wherever its devices are: a distance without motion
    is an offset, which decreases. After a gap in either position, or a jump of either, the pair
    continues from its last position in the same way.
    """

    def __init__(
        self,
        first: Device,
        second: Device,
        limits: Sequence[DeviceLimits] = (),
        alignment: Alignment | None = None,
    ) -> None:
        self.first, self.second = first, second
        self._alignment = alignment
        self._jumps = Jumps(first), Jumps(second)
        self._place: Vector = ZERO  # last position of the pair
        self._offset: Vector = ZERO
        self._read_at = -1
        # offset when they were last aligned [m]
        self.met_apart = 0.0
        self._device_limits = tuple(limits) or (first.limits, second.limits)
        nowhere = (math.nan, math.nan, math.nan)
        self.places: tuple[Vector, Vector] = (nowhere, nowhere)
        self._known = False  # whether both positions are valid, so that a force may act

    @property
    def limits(self) -> DeviceLimits:
        """The lower of each limit; as workspace, all possible differences of positions."""
        a, b = self._device_limits
        x, y, z = (
            (p[0] - q[1], p[1] - q[0])
            for p, q in zip(a.workspace, b.workspace, strict=True)
        )
        workspace: Workspace = (x, y, z)
        known = None not in (a.latency, b.latency)
        return DeviceLimits(
            peak_force=min(a.peak_force, b.peak_force),
            continuous_force=min(a.continuous_force, b.continuous_force),
            slew=min(a.slew, b.slew),
            silence=min(a.silence, b.silence),
            # No force remains once the later device has let go; after the earlier one, a single
            # device is left.
            hold=max(a.hold, b.hold),
            lets_go=min(
                one.hold if one.lets_go is None else one.lets_go for one in (a, b)
            ),
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
        """Return their distance; NaN if a position is unknown, or outside its own workspace."""
        a = self.first.read_position(seq)
        b = self.second.read_position(seq)
        self.places = a, b
        # record jumps also while a position is unknown
        jumped = [jumps.again() for jumps in self._jumps]
        was_known = self._known and not any(jumped)
        self._known = all(math.isfinite(x) for x in (*a, *b)) and not self.outside()
        if not self._known:
            return (math.nan, math.nan, math.nan)
        apart = (a[0] - b[0], a[1] - b[1], a[2] - b[2])
        if self._alignment is None:
            return apart
        return self._aligned(apart, seq, was_known, self._alignment)

    def _aligned(
        self, apart: Vector, seq: int, was_known: bool, alignment: Alignment
    ) -> Vector:
        """Return the position of the pair: the devices' distance less an offset that decreases."""
        if self._read_at < 0 and max(map(abs, apart)) > alignment.apart:
            raise OSError(
                f"the devices stand ({', '.join(f'{x:.4g}' for x in apart)}) m apart, limit apart:"
                f" {alignment.apart:g} m; move them together, or raise the limit"
            )
        x, y, z = self._offset
        if not was_known:
            x, y, z = (
                now - before for now, before in zip(apart, self._place, strict=True)
            )
            self.met_apart = math.hypot(x, y, z)
        else:
            size = math.hypot(x, y, z)
            left = size - alignment.step * (seq - self._read_at)
            share = left / size if left > 0.0 else 0.0
            x, y, z = x * share, y * share, z * share
        self._offset = (x, y, z)
        self._read_at = seq
        self._place = apart[0] - x, apart[1] - y, apart[2] - z
        return self._place

    def outside(self) -> str:
        """Return which of them is outside its own workspace, or ""."""
        for name, place, limits in zip(
            ("first", "second"), self.places, self._device_limits, strict=True
        ):
            for axis, at, (low, high) in zip(
                "xyz", place, limits.workspace, strict=True
            ):
                if not low <= at <= high and math.isfinite(at):
                    return (
                        f"{name}: {axis} = {at:.4g} m, outside its workspace of {low:.4g} to"
                        f" {high:.4g} m"
                    )
        return ""

    def write_force(self, force: Vector, seq: int, offset: float) -> None:
        """Push the first device, and the second the opposite way; none if a position is unknown."""
        x, y, z = force if self._known else (0.0, 0.0, 0.0)
        self.first.write_force((x, y, z), seq, offset)
        self.second.write_force((-x, -y, -z), seq, offset)

    def close(self) -> None:
        """Close both, even if the first fails."""
        try:
            self.first.close()
        finally:
            self.second.close()


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
