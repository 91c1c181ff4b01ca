"""The sim driver node: the driver of the loop with the virtual device in place of hardware."""

from __future__ import annotations

import math
from collections import deque
from typing import Annotated, Any, ClassVar

import msgspec

from messages.types import Vector
from nodes.base.setup import AXIS_INDEX, Setup
from nodes.driver.device import Device, DeviceLimits
from nodes.driver.node import Driver, DriverParameters
from sim.device.model import DeviceModel
from sim.device.state import VirtualDevice


class SimDriverParameters(DriverParameters, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Parameters of the sim driver.

    Attributes
    ----------
    device : DeviceModel
        The virtual device; see sim/device/model.py.
    hold : float or None
        The device's own deadline, as a servo thread has one: without a new force for so long it lets go [s]. Real time
        only; None holds for ever.
    """

    device: DeviceModel
    hold: Annotated[float, msgspec.Meta(gt=0.0)] | None = None


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
    """

    def __init__(self, model: DeviceModel, setup: Setup, hold: float | None = None) -> None:
        self._hold = math.inf if hold is None else hold
        self._axis = AXIS_INDEX[setup.axes[0]]
        self._period = setup.period
        self._lockstep = setup.pace == "lockstep"
        self._delay = model.delay
        self._device = VirtualDevice(model, setup.period, self._lockstep and setup.apply == "next_tick")
        self._tick = -1
        self._acting = 0.0
        self._commanded = 0.0
        # Commanded forces that have not taken effect: when, in ticks since tick 0, and what.
        self._pending: deque[tuple[float, float]] = deque()

    @property
    def limits(self) -> DeviceLimits:
        """A virtual device bears everything; what its motor cannot give, the model saturates. Its delay is its latency."""
        return DeviceLimits(hold=self._hold, latency=self._delay * self._period)

    def open(self) -> None:
        """Nothing to connect."""

    def read_position(self, seq: int) -> Vector:
        """Let the time up to a tick pass, then read the encoder.

        Parameters
        ----------
        seq : int
            Tick number.

        Returns
        -------
        tuple of float, shape (3,)
            Measured position [m].
        """
        if not self._lockstep:
            if self._tick < 0:
                # Respawned, or started late: the device is put there now, it was not falling all the time.
                self._tick = self._device.ticks = seq
            while self._tick < seq:
                self._pass_tick()
        vector = [0.0, 0.0, 0.0]
        vector[self._axis] = self._device.measured()
        return vector[0], vector[1], vector[2]

    def _pass_tick(self) -> None:
        start, now = float(self._tick), 0.0
        if (start - self._commanded) * self._period >= self._hold:
            self._acting = 0.0
        while self._pending and self._pending[0][0] < start + 1.0:
            when, force = self._pending.popleft()
            self._commanded = when
            offset = max(when - start, now)
            self._device.pass_time(self._acting, (offset - now) * self._period)
            self._acting, now = force, offset
        self._device.pass_time(self._acting, (1.0 - now) * self._period)
        self._device.end_tick()
        self._tick += 1

    def write_force(self, force: Vector, seq: int, offset: float) -> None:
        """Hand over a force.

        Parameters
        ----------
        force : tuple of float, shape (3,)
            Force [N].
        seq : int
            Tick during which it arrives.
        offset : float
            Where in that tick [ticks].
        """
        value = force[self._axis]
        if self._lockstep:
            # The model itself knows about ``next_tick``: the whole tick passes here, on exactly the one-process path.
            self._device.tick(value)
        else:
            self._pending.append((seq + offset + self._delay, value))

    def close(self) -> None:
        """Nothing to disconnect."""


class SimDriver(Driver):
    """A driver node with a virtual device of one axis."""

    Parameters: ClassVar[type[msgspec.Struct]] = SimDriverParameters
    virtual: ClassVar[bool] = True

    def make_device(self) -> Device:
        """Make the virtual device.

        Returns
        -------
        Device
            In the driver's time.
        """
        parameters: Any = self.store.current
        return TimedDevice(parameters.device, self.setup, parameters.hold)
