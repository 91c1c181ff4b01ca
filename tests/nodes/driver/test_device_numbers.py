"""Positions of a device: numbers of any type are accepted, others reported clearly."""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
import pytest

from messages.codec import Decoder, encode
from messages.types import ZERO, DeviceState, Vector
from nodes.driver.calls import DeviceCalls, Jumps, numbers_of
from nodes.driver.device import DeviceLimits


class Arm:
    """A device that returns or raises what it is given."""

    limits = DeviceLimits()

    def __init__(self, gives: Any) -> None:
        self._gives = gives

    def open(self) -> None:
        """Do nothing."""

    def read_position(self, seq: int) -> Any:
        """Return the scripted position."""
        del seq
        if isinstance(self._gives, Exception):
            raise self._gives
        return self._gives

    def write_force(self, force: Vector, seq: int, offset: float) -> None:
        """Ignore the force."""
        del force, seq, offset

    def close(self) -> None:
        """Do nothing."""


@pytest.mark.parametrize(
    "given",
    [
        np.array([0.25, -0.5, 1.0], np.float32),
        [np.float64(0.25), np.float16(-0.5), np.int64(1)],
        np.array([[0.25], [-0.5], [1.0]]).T[0],
    ],
    ids=["array", "scalars", "view"],
)
def test_numbers_of_numpy_are_plain_numbers_in_every_message(given: Any) -> None:
    """They failed at encoding, which hid the device's own error."""
    position = numbers_of(given, "arm")
    assert [type(part) for part in position] == [float] * 3
    state = DeviceState(seq=0, stamp=0.0, position=position, force=ZERO, force_seq=-1)
    assert Decoder(DeviceState).decode(encode(state)).position == (0.25, -0.5, 1.0)


def read(device: Arm) -> tuple[int, list[float], DeviceCalls]:
    """Read a position as compiled ticks do: by address."""
    calls = DeviceCalls(device, lambda: ZERO, Jumps(device))
    function = ctypes.CFUNCTYPE(
        ctypes.c_int, ctypes.c_int64, ctypes.c_int64, ctypes.POINTER(ctypes.c_double)
    )
    out = (ctypes.c_double * 6)(*[7.0] * 6)
    status = function(calls.calls.read)(calls.calls.context, 0, out)
    return status, list(out), calls


def test_a_device_s_own_error_is_the_one_that_is_told() -> None:
    status, out, calls = read(Arm(np.array([0.25, -0.5, 1.0], np.float32)))
    assert (status, out[:3]) == (0, [0.25, -0.5, 1.0])
    calls.raise_error()
    status, out, calls = read(Arm(OSError("the cable is out")))
    # Nothing is taken for a position that was not read.
    assert (status, out) == (-1, [7.0] * 6)
    with pytest.raises(OSError, match="the cable is out"):
        calls.raise_error()


@pytest.mark.parametrize(
    "given",
    [None, (0.0, 0.0), np.zeros(4), ("x", 0.0, 0.0), np.zeros((3, 2)).tolist(), 1.0],
)
def test_what_is_no_position_is_told_with_the_device_s_name(given: Any) -> None:
    status, _, calls = read(Arm(given))
    assert status == -1
    with pytest.raises(
        TypeError,
        match=r"Arm: read_position\(\) gave .*, expected three numbers in metres",
    ):
        calls.raise_error()
