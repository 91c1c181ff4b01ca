"""The sim driver node: the driver of the loop with the virtual device in place of hardware."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Final

import msgspec

from messages.types import ZERO, Vector
from nodes.base.setup import AXIS_INDEX, Setup
from nodes.driver.device import Device, DeviceLimits
from nodes.driver.node import Driver
from nodes.driver.parameters import DriverParameters
from nodes.parameters.store import ParameterError, convert
from nodes.view.pointer import PointerParameters, PointerReader, pointer_file
from sim.device.model import DeviceModel, Hand, move_towards
from sim.device.presets import preset, provenance
from sim.device.several_axes import SeveralAxes, along
from sim.device.state import VirtualDevice

if TYPE_CHECKING:
    from nodes.tick.library import Kernel
    from sim.device.tick.ticks import DriverTicks


NO_END: Final = DeviceLimits().workspace
"""The workspace of a device that declares none [m]."""


class SimDriverParameters(DriverParameters, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Parameters of the sim driver.

    Attributes
    ----------
    device : DeviceModel
        The virtual device; see sim/device/model.py.
    hold : float or None
        The device's own deadline, as a servo thread has one: without a new force for so long it lets go [s]. Real time
        only; None holds for ever.
    pointer : PointerParameters or None
        Lets a page drag the target of the device's hand (nodes/view/pointer.py). Real time only: in lockstep the hand keeps to
        its path. None for a hand that nobody drags.
    preset : str
        A real device whose published values go before those of `device`, e.g. ``touch_x``; empty or ``none`` for none. Its
        largest force is a limit of the driver too.
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
        if self.preset not in ("", "none"):
            values = msgspec.to_builtins(self.device) | preset(self.preset)
            device = msgspec.convert(values, DeviceModel)
            # Frozen for everybody else: this is a part of its making.
            msgspec.structs.force_setattr(self, "device", device)
            if device.peak_force is not None:
                peak = min(self.safety.peak_force or math.inf, device.peak_force)
                msgspec.structs.force_setattr(self, "safety", msgspec.structs.replace(self.safety, peak_force=peak))


class DraggedHand:
    """The target of a hand that a page may drag away from its path, at a limited speed.

    Parameters
    ----------
    hand : Hand
        The hand, with its path.
    parameters : PointerParameters
        Speed and silence.
    setup : Setup
        Run directory, period and axis.

    Attributes
    ----------
    reader : PointerReader
        Where the page's target stands.
    farthest : float
        Longest way of its target in a tick [m].
    away : float or None
        Where its target is, as long as that is not its path's [m].
    """

    def __init__(self, hand: Hand, parameters: PointerParameters, setup: Setup) -> None:
        self._point = hand.point
        self._period = setup.period
        self._axis = AXIS_INDEX[setup.axes[0]]
        self.farthest = parameters.speed * setup.period
        self.reader = PointerReader(pointer_file(setup.run_dir, setup.name), parameters.silence)
        self.away: float | None = None

    def target(self, seq: int) -> float:
        """Move the target by one tick."""
        rest = self._point(seq * self._period)
        held = self.reader.read()
        if held is None and self.away is None:
            return rest
        target = move_towards(
            rest if held is None else held[self._axis], rest if self.away is None else self.away, self.farthest
        )
        # Back on its path the hand is its own again.
        self.away = None if held is None and target == rest else target
        return target


class TimedDevice:
    """The virtual device in the driver's time: forces take effect when they arrive, plus the model's own delay.

    Parameters
    ----------
    model : DeviceModel
        The device.
    setup : Setup
        Pace, period and axis of the run.
    hold : float or None
        The device's own deadline [s].
    dragged : DraggedHand or None
        What may move the target of its hand.
    workspace : tuple of float, shape (2,)
        Where it stops [m]: as a real device does, it has a mechanical stop where its workspace ends.

    Attributes
    ----------
    target : tuple of float, shape (3,)
        Where its hand pulls to during this tick [m]; zero without a hand.
    dragged : DraggedHand or None
        The same.
    device : VirtualDevice
        The device.
    axis : int
        Its axis.
    tick : int
        Tick up to which time has passed; -1 before the first sample.
    acting : float
        Force that acts now [N].
    commanded : float
        When it took effect [ticks since tick 0].
    pending : deque of tuple of float
        Commanded forces that have not taken effect: when, and what [ticks since tick 0, N].
    delay, hold : float
        From a force's arrival to its effect [ticks], and the device's own deadline [s].
    """

    def __init__(
        self,
        model: DeviceModel,
        setup: Setup,
        hold: float | None = None,
        dragged: DraggedHand | None = None,
        workspace: tuple[float, float] = NO_END[0],
    ) -> None:
        self._hand = model.hand
        self.dragged = dragged
        self.target: Vector = ZERO
        self.hold = math.inf if hold is None else hold
        self.axis = AXIS_INDEX[setup.axes[0]]
        self._period = setup.period
        self._lockstep = setup.pace == "lockstep"
        self.delay = model.delay
        self.device = VirtualDevice(model, setup.period, self._lockstep and setup.apply == "next_tick", workspace)
        self.tick = -1
        self.acting = 0.0
        self.commanded = 0.0
        self.pending: deque[tuple[float, float]] = deque()

    @property
    def limits(self) -> DeviceLimits:
        """A virtual device bears everything; what its motor cannot give, the model saturates. Its delay is its latency."""
        return DeviceLimits(hold=self.hold, latency=self.delay * self._period)

    def open(self) -> None:
        """Nothing to connect."""

    def read_position(self, seq: int) -> Vector:
        """Let the time up to a tick pass, then read the encoder."""
        if not self._lockstep:
            if self.tick < 0:
                # Respawned, or started late: the device is put there now, it was not falling all the time.
                self.tick = self.device.ticks = seq
            while self.tick < seq:
                self._pass_tick()
        if self._hand is not None:
            self._move_hand(seq, self._hand)
        return self._on_axis(self.device.measured())

    def _on_axis(self, value: float) -> Vector:
        vector = [0.0, 0.0, 0.0]
        vector[self.axis] = value
        return vector[0], vector[1], vector[2]

    def _move_hand(self, seq: int, hand: Hand) -> None:
        if self.dragged is None:
            target = hand.point(seq * self._period)
        else:
            target = self.device.target = self.dragged.target(seq)
        self.target = self._on_axis(target)

    def _pass_tick(self) -> None:
        start, now = float(self.tick), 0.0
        if (start - self.commanded) * self._period >= self.hold:
            self.acting = 0.0
        while self.pending and self.pending[0][0] < start + 1.0:
            when, force = self.pending.popleft()
            self.commanded = when
            offset = max(when - start, now)
            self.device.pass_time(self.acting, (offset - now) * self._period)
            self.acting, now = force, offset
        self.device.pass_time(self.acting, (1.0 - now) * self._period)
        self.device.end_tick()
        self.tick += 1

    def write_force(self, force: Vector, seq: int, offset: float) -> None:
        """Hand over a force."""
        value = force[self.axis]
        if self._lockstep:
            # The model itself knows about ``next_tick``: the whole tick passes here, on exactly the one-process path.
            self.device.tick(value)
        else:
            self.pending.append((seq + offset + self.delay, value))

    def close(self) -> None:
        """Nothing to disconnect."""


class SimDriver(Driver):
    """A driver node with a virtual device, alike along every axis of the scene."""

    Parameters: ClassVar[type[msgspec.Struct]] = SimDriverParameters
    virtual: ClassVar[bool] = True
    kernel_module: ClassVar[str] = "sim.device.tick.kernel"

    def compiled_ticks(self, kernel: Kernel) -> DriverTicks:
        """Make the compiled ticks."""
        from sim.device.tick.ticks import DriverTicks

        return DriverTicks(self, kernel)

    @classmethod
    def stand_in(
        cls, parameters: Mapping[str, Any], name: str, device: str
    ) -> tuple[dict[str, Any], dict[str, Any]] | None:
        """Put a preset in the place of the device that is described."""
        changed = {**parameters, "preset": device}
        model: DeviceModel = convert(changed, cls.Parameters, name).device
        return changed, {
            "mass": model.moving_mass,
            "damping": model.moving_damping,
            "stiffness": model.grip,
            "device_delay": model.delay,
        }

    def configure(self) -> None:
        """Make the device, and say what is known of the real one that it stands for."""
        super().configure()
        if self.store.current.preset not in ("", "none"):
            self.announce("device", provenance(self.store.current.preset))

    @classmethod
    def check(cls, setup: Setup) -> None:
        """Check that it begins inside its workspace, and that a pointer has a hand to drag."""
        super().check(setup)
        parameters: SimDriverParameters = convert(setup.parameters, cls.Parameters, setup.name)
        begin = parameters.device.position
        low, high = parameters.ends[AXIS_INDEX[setup.axes[0]]]
        if not low <= begin <= high:
            raise ParameterError(
                f"{setup.name}.device.position: {begin:g} m, expected {low:g} to {high:g} m, as safety.workspace says"
            )
        if parameters.pointer is not None and parameters.device.hand is None:
            raise ParameterError(
                f"{setup.name}.pointer: needs {setup.name}.device.hand, whose target a page can drag; declare its stiffness "
                "and path, or leave the pointer out"
            )

    def make_device(self) -> Device:
        """Make the virtual device."""
        parameters: SimDriverParameters = self.store.current
        pointer = parameters.pointer if self.setup.pace == "realtime" else None
        axes = self.setup.axes
        parts = []
        for axis, model in zip(axes, along(parameters.device, axes), strict=True):
            alone = msgspec.structs.replace(self.setup, axes=[axis])
            dragged = None if model.hand is None or pointer is None else DraggedHand(model.hand, pointer, alone)
            parts.append(TimedDevice(model, alone, parameters.hold, dragged, parameters.ends[AXIS_INDEX[axis]]))
        self._timed = parts[0] if len(parts) == 1 else SeveralAxes(parts)
        return self._timed

    def load_kernel(self) -> None:
        """Load the compiled ticks, which are those of one axis."""
        if len(self.setup.axes) == 1:
            super().load_kernel()
        elif self.setup.tick == "compiled":
            self.tell("tick", "plain: the device has several axes")

    @property
    def target(self) -> Vector:
        """Where the hand pulls the device to during this tick [m]; zero without one."""
        return self._timed.target
