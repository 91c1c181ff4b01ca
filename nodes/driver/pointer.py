"""The mouse as a hand: a page writes the hand's target, a sim driver reads it every tick.

Both map one small file in the run's private directory. The value is sequence-locked: the writer
increments a count before and after, in memory order, and the reader uses the value only if both
counts agree. A tick pays less than a microsecond, and nobody waits. A value that is not renewed
expires.
"""

from __future__ import annotations

import ctypes
import fcntl
import math
import os
import struct
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import msgspec

from messages.types import ZERO, Vector
from nodes.base.setup import Setup
from nodes.base.shared_file import FILE_TIMEOUT, awaited, mapped

_VALUE = struct.Struct("<QddddQ")
"""Count after the value, target [m], time [s], count before; read in this order.

sim/device/state.py reads it too.
"""

_COUNT = struct.Struct("<Q")
_TARGET = struct.Struct("<dddd")

# time without a new value after which a pointer is released: its view has ended, or hangs [s]
SILENCE = 2.0


class PointerParameters(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True
):
    """How a hand follows a pointer.

    speed: Largest speed of the hand's target [m/s].
    silence: Time without a new value after which the hand is released and its target returns to its
        path [s].
    beyond: Whether a page may make the loop unstable on purpose, and rearm the driver afterwards.
        Only a virtual driver has a pointer, so nothing breaks and nobody is pushed.
    """

    speed: Annotated[float, msgspec.Meta(gt=0.0)] = 0.5
    silence: Annotated[float, msgspec.Meta(gt=0.0)] = SILENCE
    beyond: bool = False


def pointer_file(run_dir: str | Path, driver: str) -> Path:
    """Return the path of a driver's pointer file."""
    return Path(run_dir) / f"{driver}.pointer"


def awaited_pointer(
    driver: Setup, given_up: Callable[[], bool], patience: float = FILE_TIMEOUT
) -> Path:
    """Return the path of a driver's pointer file; wait for it if the launch promises one."""
    path = pointer_file(driver.run_dir, driver.name)
    promised = (
        driver.parameters.get("pointer") is not None and driver.pace == "realtime"
    )
    return awaited(path, _VALUE.size, driver, given_up, patience) if promised else path


class PointerReader:
    """The driver's end; creates the file."""

    def __init__(self, path: Path, silence: float) -> None:
        self._map = mapped(path, _VALUE.size, make=True)
        # address of the mapped file for compiled code
        self.address = ctypes.addressof(ctypes.c_char.from_buffer(self._map))
        self.silence = silence
        self._unpack = _VALUE.unpack_from
        # last target read [m], and when it was written [s]
        self.last: tuple[float, float, float, float] = (0.0, 0.0, 0.0, -math.inf)

    def read(self) -> Vector | None:
        """Return the target [m], or None if it has expired."""
        after, x, y, z, when, before = self._unpack(self._map)
        if after == before:
            self.last = x, y, z, when
        else:
            # being written: the previous value is at most one frame of the page old
            x, y, z, when = self.last
        return (x, y, z) if time.monotonic() - when < self.silence else None

    def close(self) -> None:
        """Close the file."""
        self._map.close()


class PointerWriter:
    """The page's end; FileNotFoundError if no driver has created the file."""

    def __init__(self, path: Path) -> None:
        self._map = mapped(path, _VALUE.size, make=False)
        self._file = os.open(path, os.O_RDONLY)
        self._count = _COUNT.unpack_from(self._map, 0)[0]

    def write(self, target: Vector) -> None:
        """Set the target [m], until it expires."""
        if not all(map(math.isfinite, target)):
            raise ValueError(f"pointer: {target} m, expected three finite numbers")
        self._write(target, time.monotonic())

    def take(self) -> bool:
        """Return whether this view has exclusive control of the hand, until it leaves or dies."""
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True

    def leave(self) -> None:
        """Leave the hand to others."""
        fcntl.flock(self._file, fcntl.LOCK_UN)

    def let_go(self) -> None:
        """Release the hand to its path at once."""
        self._write(ZERO, -math.inf)

    def _write(self, target: Vector, when: float) -> None:
        self._count += 1
        _COUNT.pack_into(self._map, _VALUE.size - _COUNT.size, self._count)
        _TARGET.pack_into(self._map, _COUNT.size, *target, when)
        _COUNT.pack_into(self._map, 0, self._count)

    def close(self) -> None:
        """Close the file."""
        self._map.close()
        os.close(self._file)
