"""A sim driver whose device fails on command, for the drill."""

import os
import struct
import time
from collections import deque
from typing import Any, ClassVar

import msgspec

from messages.types import ZERO, Vector
from nodes.driver.device import Device, DeviceLimits
from sim.device.driver import SimDriver, SimDriverParameters

# Orders: a force call that never returns, and a library that exits with 0.
HANG, EXIT = "hang", "exit"
# Prefixes: positions times a factor, positions of so many samples before. Else a number is the
# position [m].
SCALE, LATE = "scale ", "late "
# Prefix of an offset of the positions without motion [m].
MOVED = "moved "
# Prefixes of a call that raises, and of the duration of a read [s].
FAILS, BLOCKS = "fails in ", "blocks "
# Entry of the log: time [s], tick, jumps so far, force [N], last position read [m].
LOGGED = "<dqq3d3d"
_LATEST = 100


class FaultyDriverParameters(
    SimDriverParameters, frozen=True, forbid_unknown_fields=True, kw_only=True
):
    """Parameters of the driver."""

    order: str  # file with the ordered fault; without it the device works
    log: str = ""  # file in which each force is logged; empty for none


class FaultyDevice:
    """Forwards every call, except for ordered faults."""

    def __init__(self, device: Device, order: str, log: str = "") -> None:
        self._device, self._order = device, order
        # Open as long as the device.
        self._log = open(log, "ab", buffering=0) if log else None  # noqa: SIM115
        self._positions = deque([ZERO], maxlen=_LATEST)
        self._read = ZERO  # last position returned [m]
        self._offset = 0.0
        self.jumps = 0  # number of position jumps without motion

    @property
    def limits(self) -> DeviceLimits:
        """Limits of the hardware."""
        return self._device.limits

    def _ordered(self) -> str:
        if not os.path.exists(self._order):
            return ""
        with open(self._order, encoding="ascii") as file:
            return file.read()

    def _meet(self, call: str, order: str) -> None:
        if order == FAILS + call:
            raise OSError(
                f"faulty device: {call}() fails, as a device does that was unplugged"
            )

    def meet(self, call: str) -> None:
        """Raise if `call` is ordered to fail."""
        self._meet(call, self._ordered())

    def open(self) -> None:
        """Open the device; fail if ordered."""
        self._meet("open", self._ordered())
        self._device.open()

    def read_position(self, seq: int) -> Vector:
        """Read the position, or do what is ordered."""
        self._read = self._read_as_ordered(seq)
        return self._read

    def _read_as_ordered(self, seq: int) -> Vector:
        position = self._device.read_position(seq)
        self._positions.append(position)
        order = self._ordered()
        self._meet("read_position", order)
        offset = float(order.removeprefix(MOVED)) if order.startswith(MOVED) else 0.0
        if offset != self._offset:
            self._offset = offset
            self.jumps += 1
        if order.startswith(MOVED):
            return (position[0] + offset, position[1] + offset, position[2] + offset)
        if order in ("", HANG) or order.startswith(FAILS):
            return position
        if order.startswith(BLOCKS):
            time.sleep(float(order.removeprefix(BLOCKS)))
            return position
        if order == EXIT:
            os._exit(0)
        if order.startswith(LATE):
            return self._positions[
                max(-1 - int(order.removeprefix(LATE)), -len(self._positions))
            ]
        if order.startswith(SCALE):
            factor = float(order.removeprefix(SCALE))
            return (factor * position[0], factor * position[1], factor * position[2])
        return (float(order),) * 3

    def write_force(self, force: Vector, seq: int, offset: float) -> None:
        """Hand over a force; hang if ordered."""
        at = time.monotonic()  # the driver read its clock just before
        while (order := self._ordered()) == HANG:
            time.sleep(0.1)
        self._meet("write_force", order)
        if self._log is not None:
            self._log.write(
                struct.pack(LOGGED, at, seq, self.jumps, *force, *self._read)
            )
        self._device.write_force(force, seq, offset)

    def close(self) -> None:
        """Close the device; then fail if ordered."""
        self._device.close()
        self._meet("close", self._ordered())


class FaultyDriver(SimDriver):
    """A driver node with a faulty device."""

    Parameters: ClassVar[type[msgspec.Struct]] = FaultyDriverParameters

    def make_device(self) -> Device:
        """Create the virtual device and wrap it."""
        parameters: Any = self.store.current
        self._faulty = FaultyDevice(
            super().make_device(), parameters.order, parameters.log
        )
        return self._faulty

    def condition(self) -> str:
        """Return the device's condition; raise if ordered."""
        self._faulty.meet("condition")
        return super().condition()
