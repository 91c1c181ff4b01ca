"""Log of a faulty device: each force it received, with tick, jumps and position."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import NamedTuple

from messages.types import Vector
from sim.drill.faulty_device import LOGGED
from sim.drill.writes import Write


class Sample(NamedTuple):
    """One force that the device was given.

    Attributes
    ----------
    write : Write
        Time [s] and force [N].
    seq : int
        Tick of the driver.
    jumps : int
        Number of jumps without motion in this process of the driver.
    position : Vector
        Last position read from the device [m].
    """

    write: Write
    seq: int
    jumps: int
    position: Vector


def read_log(path: Path, period: float) -> list[Sample]:
    """Return the forces of a log in order, without an incomplete last one; `period` in s."""
    whole = path.read_bytes()
    size = struct.calcsize(LOGGED)
    return [
        Sample(Write(at, (fx, fy, fz), seq * period), seq, jumps, (x, y, z))
        for at, seq, jumps, fx, fy, fz, x, y, z in struct.iter_unpack(
            LOGGED, whole[: len(whole) // size * size]
        )
    ]
