"""The sim driver node: the driver of the loop with the virtual device in place of hardware."""

import math
from array import array
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, ClassVar, Final

import msgspec

from messages.types import Vector
from nodes.base.setup import AXIS_INDEX, Axis, Setup
from nodes.compiled.message_fields import NotCompilableError
from nodes.driver.calls import Calls
from nodes.driver.device import Device, DeviceLimits, Workspace
from nodes.driver.motion import set_latency
from nodes.driver.node import Driver
from nodes.driver.parameters import DriverParameters
from nodes.driver.pointer import PointerParameters, PointerReader, pointer_file
from nodes.parameters.store import ParameterError, convert
from sim.device.model import DeviceModel
from sim.device.real_devices import preset, provenance
from sim.device.state import PENDING, VirtualDevice, read_axis, write_axis

# The usual limits of a virtual device, as in the scenarios: largest force [N], fastest change of it
# [N/s], workspace [m].
PEAK, SLEW, REACH = 40.0, 20_000.0, 0.2
NO_END: Final = DeviceLimits().workspace  # the workspace of a device that declares none [m]


class SimDriverParameters(DriverParameters, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Parameters of the sim driver.

    device: The virtual device; see sim/device/model.py.
    hold: The device's own deadline, as a servo thread has one: without a new force for so long it
        lets go [s]. Real time only; None holds for ever.
    pointer: Lets a page drag the target of the device's hand (nodes/driver/pointer.py). Real time
        only: in lockstep the hand keeps to its path. None for a hand that nobody drags.
    safety: As of every driver. Where neither limits nor ``without`` say otherwise, a virtual device
        has a largest force of 40 N, a slew of 20 000 N/s, and a workspace of 0.2 m around the
        places that its `device` names.
    preset: A real device whose published values go before those of `device`, e.g. ``touch_x``;
        empty or ``none`` for none. Its largest force is a limit of the driver too.
    """

    device: DeviceModel
    hold: Annotated[float, msgspec.Meta(gt=0.0)] | None = None
    pointer: PointerParameters | None = None
    preset: str = ""

    @property
    def ends(self) -> tuple[tuple[float, float], ...]:
        """Where the device stops, axis by axis [m]."""
        return self.safety.workspace or NO_END

    def __post_init__(self) -> None:
        self._limit()
        if self.preset not in ("", "none"):
            device = msgspec.convert(
                msgspec.to_builtins(self.device) | preset(self.preset), DeviceModel
            )
            # Frozen for everybody else: this is a part of its making.
            msgspec.structs.force_setattr(self, "device", device)
            if device.peak_force is not None:
                peak = min(self.safety.peak_force or math.inf, device.peak_force)
                msgspec.structs.force_setattr(
                    self, "safety", msgspec.structs.replace(self.safety, peak_force=peak)
                )

    def _limit(self) -> None:
        """Fill in the limits that the launch file leaves out: a made-up device bears everything, its user does not."""
        safety = self.safety
        usual: dict[str, Any] = {
            "peak_force": PEAK,
            "slew": SLEW,
            "workspace": _workspace(self.device),
        }
        missing = {
            name: value
            for name, value in usual.items()
            if getattr(safety, name) is None and name not in safety.without
        }
        if missing:
            # Frozen for everybody else: this is a part of its making.
            msgspec.structs.force_setattr(
                self, "safety", msgspec.structs.replace(safety, **missing)
            )


def _workspace(model: DeviceModel) -> Workspace:
    """Return the usual workspace of a device [m]: `REACH` around the origin and all places that the launch file names."""
    parts = [model, *map(model.along, model.axes)]
    places = [0.0, *(part.position for part in parts)]
    places += [place for part in parts if part.hand is not None for _, place in part.hand.path]
    low, high = min(places) - REACH, max(places) + REACH
    return (low, high), (low, high), (low, high)


def along(model: DeviceModel, axes: Sequence[str]) -> list[DeviceModel]:
    """Give each axis its device: the first begins and has the hand's path, z weighs, or the first; its own words go before."""
    down = "z" if "z" in axes else axes[0]
    hand = model.hand
    still = None if hand is None else msgspec.structs.replace(hand, path=[(0.0, 0.0)], repeat=None)
    return [
        msgspec.structs.replace(
            model,
            gravity=model.gravity if axis == down else None,
            **({} if axis == axes[0] else {"position": 0.0, "velocity": 0.0, "hand": still}),
        ).along(axis)
        for axis in axes
    ]


def parts_of(
    model: DeviceModel,
    axes: Sequence[Axis],
    period: float,
    next_tick: bool = False,
    workspace: Sequence[tuple[float, float]] = NO_END,
    lockstep: bool = True,
    hold: float = math.inf,
    compiled: bool = False,
) -> list[VirtualDevice]:
    """Make the device of each axis of a scene; see `sim.device.state.VirtualDevice`."""
    numbers = [AXIS_INDEX[axis] for axis in axes]
    return [
        VirtualDevice(of_axis, period, next_tick, workspace[i], lockstep, hold, i, compiled)
        for i, of_axis in zip(numbers, along(model, axes), strict=True)
    ]


class SimDevice:
    """The virtual device in the driver's time: one along each axis, independent, a stop where its workspace ends."""

    def __init__(
        self,
        model: DeviceModel,
        setup: Setup,
        hold: float | None = None,
        pointer: PointerParameters | None = None,
        workspace: Sequence[tuple[float, float]] = NO_END,
    ) -> None:
        lockstep = setup.pace == "lockstep"
        self._compiled = setup.tick == "compiled"
        self._limits = DeviceLimits(
            hold=math.inf if hold is None else hold, latency=model.delay * setup.period
        )
        next_tick = lockstep and setup.apply == "next_tick"
        # The devices of all axes.
        self.parts = parts_of(
            model,
            setup.axes,
            setup.period,
            next_tick,
            workspace,
            lockstep,
            self._limits.hold,
            self._compiled,
        )
        self._states = [part.state for part in self.parts]
        self._reader: PointerReader | None = None
        if model.hand is not None and pointer is not None and not lockstep:
            self._reader = PointerReader(pointer_file(setup.run_dir, setup.name), pointer.silence)
            for d in self._states:
                d.pointer, d.silence = self._reader.address, pointer.silence
                d.farthest = pointer.speed * setup.period
        self._clock = array("q", [0, 0])

    def delay_by(self, ticks: float) -> None:
        """Have every force from now on act so many ticks later; those under way arrive as they would have, none overtakes."""
        for d in self._states:
            d.delay = ticks

    @property
    def limits(self) -> DeviceLimits:
        """A virtual device bears everything; what its motor cannot give, the model saturates. Its delay is its latency."""
        return self._limits

    def calls(self) -> Calls | None:
        """Give the compiled calls, where they could be had."""
        if not self._compiled:
            return None
        from nodes.compiled.library import functions, obtain_calls

        try:
            read, write = obtain_calls(SimDriver.device_module, ("read", "write"))
        except NotCompilableError:
            # Then the driver calls it as any device that is written in Python.
            return None
        for d in self._states:
            d.clock_gettime, d.time = functions()["clock_gettime"], self._clock.buffer_info()[0]
        self._context = array(
            "q", [len(self.parts), *(part.address for part in self.parts), 0, 0][:4]
        )
        return Calls(read, write, self._context.buffer_info()[0])

    @property
    def target(self) -> Vector:
        """Where its hand pulls to during this tick [m]; zero without one."""
        pulls = [0.0, 0.0, 0.0]
        for d in self._states:
            pulls[d.axis] = d.pull
        return pulls[0], pulls[1], pulls[2]

    def open(self) -> None:
        """Nothing to connect."""

    def read_position(self, seq: int) -> Vector:
        """Let the time up to a tick pass, then read the encoders."""
        position = [0.0, 0.0, 0.0]
        for d in self._states:
            position[d.axis] = read_axis(d, seq)
        return position[0], position[1], position[2]

    def write_force(self, force: Vector, seq: int, offset: float) -> None:
        """Hand over a force: each axis takes its own part."""
        for d in self._states:
            if not write_axis(d, force[d.axis], seq, offset):
                raise OverflowError(
                    f"more than {PENDING} forces on their way to the virtual device"
                )

    def close(self) -> None:
        """Nothing to disconnect."""


class SimDriver(Driver):
    """A driver node with a virtual device, alike along every axis of the scene."""

    Parameters: ClassVar[type[msgspec.Struct]] = SimDriverParameters
    virtual: ClassVar[bool] = True
    device_module: ClassVar[str] = "sim.device.kernel"
    movable: ClassVar[str] = "device.delay and passivity"

    @classmethod
    def substitute_device(
        cls, parameters: Mapping[str, Any], name: str, device: str
    ) -> tuple[dict[str, Any], dict[str, Any]] | None:
        """Put a preset in the place of the device that is described."""
        changed = {**parameters, "preset": device}
        model: DeviceModel = convert(changed, cls.Parameters, name).device
        return changed, {
            "mass": model.moving_masses[0],
            "heaviest": model.moving_masses[1] if model.mass_by_position else None,
            "damping": model.moving_damping,
            "stiffness": model.grip,
            "device_delay": model.delay,
        }

    @classmethod
    def plant(
        cls, parameters: Mapping[str, Any], name: str, axes: Sequence[Axis]
    ) -> dict[str, float]:
        """Return the plant that the device is, its hand included; where its axes differ, the worst of each value."""
        model: DeviceModel = convert(parameters, cls.Parameters, name).device
        parts = along(model, axes)
        least, greatest = (
            min(part.moving_masses[0] for part in parts),
            max(part.moving_masses[1] for part in parts),
        )
        return {
            "mass": least,
            **({"heaviest": greatest} if greatest > least else {}),
            "damping": min(part.moving_damping for part in parts),
            "stiffness": max(part.grip for part in parts),
            "device_delay": max(part.delay for part in parts),
        }

    def configure(self) -> None:
        """Make the device, and say what is known of the real one that it stands for."""
        super().configure()
        if self.store.current.preset not in ("", "none"):
            self.events.emit_each("device", provenance(self.store.current.preset))

    @classmethod
    def check(cls, setup: Setup) -> None:
        """Check that it begins inside its workspace, and that a pointer has a hand to drag."""
        super().check(setup)
        parameters: SimDriverParameters = convert(setup.parameters, cls.Parameters, setup.name)
        for axis, device in zip(setup.axes, along(parameters.device, setup.axes), strict=True):
            low, high = parameters.ends[AXIS_INDEX[axis]]
            if not low <= device.position <= high:
                field = "position" if axis == setup.axes[0] else f"axes.{axis}.position"
                raise ParameterError(
                    f"{setup.name}.device.{field}: {device.position:g} m, expected {low:g} to"
                    f" {high:g} m, as safety.workspace says"
                )
        if missing := sorted(set(parameters.device.axes) - set(setup.axes)):
            raise ParameterError(
                f"{setup.name}.device.axes.{missing[0]}: the scene computes {', '.join(setup.axes)}"
                " only; name it in run.axes, or leave it out here"
            )
        if parameters.pointer is not None and parameters.device.hand is None:
            raise ParameterError(
                f"{setup.name}.pointer: needs {setup.name}.device.hand, whose target a page can"
                " drag; declare its stiffness and path, or leave the pointer out"
            )

    def make_device(self) -> Device:
        """Make the virtual device."""
        parameters: SimDriverParameters = self.store.current
        self._sim = SimDevice(
            parameters.device, self.setup, parameters.hold, parameters.pointer, parameters.ends
        )
        return self._sim

    def prepare(self, parameters: Any) -> Callable[[int], Any]:
        """Prepare another delay of the virtual device; all else is as with every driver."""
        now: SimDriverParameters = self.store.current
        delay = parameters.device.delay
        later = msgspec.structs.replace(
            now, device=msgspec.structs.replace(now.device, delay=delay)
        )
        if parameters.device == now.device or parameters != later:
            return super().prepare(parameters)
        if self.setup.pace == "lockstep":
            raise ParameterError(
                f"{self.setup.name}.device.delay: is fixed in lockstep; launch again, or use pace:"
                " realtime"
            )

        def apply(seq: int) -> dict[str, Any]:
            self._sim.delay_by(delay)
            self._kept[1] = set_latency(self.driving, delay)
            text = f"the device answers {delay:g} ticks later from now on"
            self.events.emit("delay", text, {"delay_ticks": delay}, always=True)
            return {"seq": seq}

        return apply

    @property
    def target(self) -> Vector:
        """Where the hand pulls the device to during this tick [m]; zero without one."""
        return self._sim.target
