"""The two calls of a device, which compiled ticks make by address.

``int read(int64_t context, int64_t seq, double *out)`` writes the position at a tick [m] into the
first three of six numbers and, for a simulated hand, the point to which it pulls [m] into the
others, which are zero before the call. ``int write(int64_t context, const double *force, int64_t
seq, double offset)`` hands a force over, as the methods of `nodes.driver.device.Device` do. A
negative status means that the call failed: `out` is unchanged, and the driver repeats the call in
Python, which raises or returns a value. So a position that could not be read is never taken for 0.
`JUMPED` from ``read`` means that the position changed without motion; a device in Python counts
that in ``jumps``.

A device that needs no interpreter provides its own calls (`Compiled`); for any other one they are
made here.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from ctypes import POINTER, c_double, c_int, c_int64
from typing import Any, Final, NamedTuple, Protocol

from messages.types import Vector
from nodes.driver.device import Device

READ = ctypes.CFUNCTYPE(c_int, c_int64, c_int64, POINTER(c_double))
JUMPED: Final = 1
WRITE = ctypes.CFUNCTYPE(c_int, c_int64, POINTER(c_double), c_int64, c_double)
"""Types of the two calls."""


class Calls(NamedTuple):
    """Addresses of the two calls, and their context."""

    read: int  # addresses of the calls
    write: int
    context: int  # their first argument


class Compiled(Protocol):
    """A device that can be called without the interpreter."""

    def calls(self) -> Calls | None:
        """Return its calls, valid until it is closed; None if not available."""
        ...


class Jumps:
    """Detects jumps of a device's position without motion, by its counter ``jumps``, if any."""

    def __init__(self, device: Any) -> None:
        self._device = device
        self._last = getattr(device, "jumps", 0)

    def again(self) -> bool:
        """Return whether the position has jumped since the last call."""
        now = getattr(self._device, "jumps", 0)
        jumped = now != self._last
        self._last = now
        return jumped


def own_calls(device: Any) -> Calls | None:
    """Return the calls of a device that has its own, else None."""
    method = getattr(type(device), "calls", None)
    found = device.calls() if callable(method) else None
    return found if isinstance(found, Calls) else None


def numbers_of(position: Any, what: str) -> Vector:
    """Return a device's position as floats [m]; TypeError if it is not three numbers."""
    try:
        x, y, z = position
        return float(x), float(y), float(z)
    except (TypeError, ValueError):
        raise TypeError(
            f"{what}: read_position() gave {position!r}, expected three numbers in metres"
        ) from None


class DeviceCalls:
    """Calls of a device: its own, or made of its methods and a simulated hand's target."""

    def __init__(
        self, device: Device, target: Callable[[], Vector], jumps: Jumps
    ) -> None:
        self._device, self._target, self._jumps = device, target, jumps
        self._kept = READ(self._read), WRITE(self._write)
        read, write = (
            ctypes.cast(function, ctypes.c_void_p).value or 0 for function in self._kept
        )
        self.calls = own_calls(device) or Calls(read, write, 0)  # the two calls
        self._error: BaseException | None = None

    def _read(self, _context: int, seq: int, out: Any) -> int:
        try:
            out[0], out[1], out[2] = numbers_of(
                self._device.read_position(seq), type(self._device).__name__
            )
            out[3], out[4], out[5] = self._target()
        # compiled code cannot propagate an exception
        except BaseException as error:  # noqa: BLE001
            self._error = error
            return -1
        return JUMPED if self._jumps.again() else 0

    def _write(self, _context: int, force: Any, seq: int, offset: float) -> int:
        try:
            self._device.write_force((force[0], force[1], force[2]), seq, offset)
        # compiled code cannot propagate an exception
        except BaseException as error:  # noqa: BLE001
            self._error = error
            return -1
        return 0

    def raise_error(self) -> None:
        """Raise the exception of the last call, if any."""
        if self._error is not None:
            error = self._error
            self._error = None
            raise error
