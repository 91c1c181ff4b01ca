"""The sim driver node: the driver of the loop with a virtual device instead of hardware."""

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

# Default limits of a virtual device: largest force [N], its slew [N/s], workspace [m].
PEAK, SLEW, REACH = 40.0, 20_000.0, 0.2
NO_END: Final = DeviceLimits().workspace  # workspace of a device that declares none [m]


class SimDriverParameters(
    DriverParameters, frozen=True, forbid_unknown_fields=True, kw_only=True
):
    """Parameters of the sim driver.

    device: The virtual device; see sim/device/model.py.
    hold: The device's own deadline, like that of a servo thread: after this time without a new
        force it releases the force [s]. Real time only; None holds for ever.
    pointer: Lets a page drag the target of the device's hand (nodes/driver/pointer.py). Real time
        only: in lockstep the hand follows its path. None for a hand that cannot be dragged.
    safety: As of every driver. Unless limits or ``without`` say otherwise, a virtual device has a
        largest force of 40 N, a slew of 20 000 N/s, and a workspace of 0.2 m around the positions
        that its `device` names.
    preset: A real device whose published values override those of `device`, e.g. ``touch_x``; empty
        or ``none`` for none. Its largest force is a limit of the driver too.
    """

    device: DeviceModel
    hold: Annotated[float, msgspec.Meta(gt=0.0)] | None = None
    pointer: PointerParameters | None = None
    preset: str = ""

    @property
    def ends(self) -> tuple[tuple[float, float], ...]:
        """Return where the device stops, axis by axis [m]."""
        return self.safety.workspace or NO_END

    def __post_init__(self) -> None:
        self._limit()
        if self.preset not in ("", "none"):
            device = msgspec.convert(
                msgspec.to_builtins(self.device) | preset(self.preset), DeviceModel
            )
            # Allowed during construction only; the struct is frozen afterwards.
            msgspec.structs.force_setattr(self, "device", device)
            if device.peak_force is not None:
                peak = min(self.safety.peak_force or math.inf, device.peak_force)
                msgspec.structs.force_setattr(
                    self,
                    "safety",
                    msgspec.structs.replace(self.safety, peak_force=peak),
                )

    def _limit(self) -> None:
        """Fill in missing limits: a virtual device withstands anything, its user does not."""
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
            # Allowed during construction only; the struct is frozen afterwards.
            msgspec.structs.force_setattr(
                self, "safety", msgspec.structs.replace(safety, **missing)
            )


def _workspace(model: DeviceModel) -> Workspace:
    """Return the default workspace [m]: `REACH` around the origin and all named positions."""
    parts = [model, *map(model.along, model.axes)]
    places = [0.0, *(part.position for part in parts)]
    hands = [part.hand for part in parts if part.hand is not None]
    for hand in hands:
        for path in [hand.path, *hand.paths().values()]:
            places += [place for _, place in path]
    low = min(places) - REACH
    high = max(places) + REACH
    return (low, high), (low, high), (low, high)


def along(model: DeviceModel, axes: Sequence[str]) -> list[DeviceModel]:
    """Return the model of each axis.

    The first axis has the initial state and the hand's path; z, or else the first, has gravity. A
    hand's file of three axes has a path for each. Settings of an axis override these.
    """
    down = "z" if "z" in axes else axes[0]
    hand = model.hand
    found = []
    for axis in axes:
        is_first = axis == axes[0]
        own = msgspec.structs.replace(
            model,
            gravity=model.gravity if axis == down else None,
            hand=None if hand is None else hand.along(axis, is_first),
        )
        if not is_first:
            own = msgspec.structs.replace(own, position=0.0, velocity=0.0)
        found.append(own.along(axis))
    return found


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
    """Create the device of each axis of a scene; see `sim.device.state.VirtualDevice`."""
    numbers = [AXIS_INDEX[axis] for axis in axes]
    return [
        VirtualDevice(
            of_axis, period, next_tick, workspace[i], lockstep, hold, i, compiled
        )
        for i, of_axis in zip(numbers, along(model, axes), strict=True)
    ]


class SimDevice:
    """The virtual device in the driver's time: an independent part along each axis.

    Each part stops at the ends of its workspace.
    """

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
            self._reader = PointerReader(
                pointer_file(setup.run_dir, setup.name), pointer.silence
            )
            for d in self._states:
                d.pointer = self._reader.address
                d.silence = pointer.silence
                d.farthest = pointer.speed * setup.period
        self._clock = array("q", [0, 0])

    def delay_by(self, ticks: float) -> None:
        """Delay every force from now on by `ticks`; earlier ones keep their time."""
        for d in self._states:
            d.delay = ticks

    @property
    def limits(self) -> DeviceLimits:
        """Limits of the virtual device: no largest force, and its delay as latency."""
        return self._limits

    def calls(self) -> Calls | None:
        """Return the compiled calls; None if not requested or not available."""
        if not self._compiled:
            return None
        from nodes.compiled.library import functions, obtain_calls

        try:
            read, write = obtain_calls(SimDriver.device_module, ("read", "write"))
        except NotCompilableError:
            # The driver then calls the Python methods.
            return None
        for d in self._states:
            d.clock_gettime, d.time = (
                functions()["clock_gettime"],
                self._clock.buffer_info()[0],
            )
        self._context = array(
            "q", [len(self.parts), *(part.address for part in self.parts), 0, 0][:4]
        )
        return Calls(read, write, self._context.buffer_info()[0])

    @property
    def target(self) -> Vector:
        """Position that its hand pulls to during this tick [m]; zero without a hand."""
        pulls = [0.0, 0.0, 0.0]
        for d in self._states:
            pulls[d.axis] = d.pull
        return pulls[0], pulls[1], pulls[2]

    def open(self) -> None:
        """Do nothing: there is nothing to connect."""

    def read_position(self, seq: int) -> Vector:
        """Simulate the time up to a tick, then read the encoders."""
        position = [0.0, 0.0, 0.0]
        for d in self._states:
            position[d.axis] = read_axis(d, seq)
        return position[0], position[1], position[2]

    def write_force(self, force: Vector, seq: int, offset: float) -> None:
        """Hand over a force; each axis takes its component."""
        for d in self._states:
            if not write_axis(d, force[d.axis], seq, offset):
                raise OverflowError(
                    f"more than {PENDING} forces in flight to the virtual device"
                )

    def close(self) -> None:
        """Do nothing: there is nothing to disconnect."""


class SimDriver(Driver):
    """A driver node with a virtual device along every axis of the scene."""

    Parameters: ClassVar[type[msgspec.Struct]] = SimDriverParameters
    virtual: ClassVar[bool] = True
    device_module: ClassVar[str] = "sim.device.kernel"
    movable: ClassVar[str] = "device.delay and passivity"

    @classmethod
    def substitute_device(
        cls, parameters: Mapping[str, Any], name: str, device: str
    ) -> tuple[dict[str, Any], dict[str, Any]] | None:
        """Replace the described device by a preset."""
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
        """Return the plant of the device with its hand; of several axes the worst values."""
        model: DeviceModel = convert(parameters, cls.Parameters, name).device
        parts = along(model, axes)
        least = min(part.moving_masses[0] for part in parts)
        greatest = max(part.moving_masses[1] for part in parts)
        plant = {
            "mass": least,
            "damping": min(part.moving_damping for part in parts),
            "stiffness": max(part.grip for part in parts),
            "device_delay": max(part.delay for part in parts),
        }
        if greatest > least:
            plant["heaviest"] = greatest
        return plant

    def configure(self) -> None:
        """Create the device, and report the sources of a preset's values."""
        super().configure()
        if self.store.current.preset not in ("", "none"):
            self.events.emit_each("device", provenance(self.store.current.preset))

    @classmethod
    def check(cls, setup: Setup) -> None:
        """Check that the device starts inside its workspace, and that a pointer has a hand."""
        super().check(setup)
        parameters: SimDriverParameters = convert(
            setup.parameters, cls.Parameters, setup.name
        )
        for axis, device in zip(
            setup.axes, along(parameters.device, setup.axes), strict=True
        ):
            low, high = parameters.ends[AXIS_INDEX[axis]]
            if not low <= device.position <= high:
                field = "position" if axis == setup.axes[0] else f"axes.{axis}.position"
                raise ParameterError(
                    f"{device.position:g} m, expected {low:g} to"
                    f" {high:g} m, as safety.workspace says",
                    path=f"{setup.name}.device.{field}",
                )
        if missing := sorted(set(parameters.device.axes) - set(setup.axes)):
            raise ParameterError(
                f"the scene computes {', '.join(setup.axes)}"
                " only; add it to run.axes, or remove it here",
                path=f"{setup.name}.device.axes.{missing[0]}",
            )
        if parameters.pointer is not None and parameters.device.hand is None:
            raise ParameterError(
                f"needs {setup.name}.device.hand, whose target a page can"
                " drag; declare its stiffness and path, or remove the pointer",
                path=f"{setup.name}.pointer",
            )

    def make_device(self) -> Device:
        """Create the virtual device."""
        parameters: SimDriverParameters = self.store.current
        self._sim = SimDevice(
            parameters.device,
            self.setup,
            parameters.hold,
            parameters.pointer,
            parameters.ends,
        )
        return self._sim

    def prepare(self, parameters: Any) -> Callable[[int], Any]:
        """Prepare a change of the device's delay; all else as every driver does."""
        now: SimDriverParameters = self.store.current
        delay = parameters.device.delay
        later = msgspec.structs.replace(
            now, device=msgspec.structs.replace(now.device, delay=delay)
        )
        if parameters.device == now.device or parameters != later:
            return super().prepare(parameters)
        if self.setup.pace == "lockstep":
            raise ParameterError(
                "is fixed in lockstep; launch again, or use pace: realtime",
                path=f"{self.setup.name}.device.delay",
            )

        def apply(seq: int) -> dict[str, Any]:
            self._sim.delay_by(delay)
            self._kept[1] = set_latency(self.driving, delay)
            text = f"the device's delay is {delay:g} ticks from now on"
            self.events.emit("delay", text, {"delay_ticks": delay}, always=True)
            return {"seq": seq}

        return apply

    @property
    def target(self) -> Vector:
        """Position that the hand pulls to during this tick [m]; zero without a hand."""
        return self._sim.target
