"""A virtual device of several axes: one of one axis along each, alike and independent of each other.

Where it begins, and the path of its hand, are along the first axis; weight is along z, where z is one of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import msgspec

from messages.types import Vector
from nodes.driver.device import Device, DeviceLimits
from sim.device.model import DeviceModel


class Part(Device, Protocol):
    """A device of one axis."""

    target: Vector
    """Where its hand pulls to [m]."""


def along(model: DeviceModel, axes: Sequence[str]) -> list[DeviceModel]:
    """Give each axis its own device."""
    down = "z" if "z" in axes else axes[0]
    hand = model.hand
    still = None if hand is None else msgspec.structs.replace(hand, path=[(0.0, 0.0)], repeat=None)
    return [
        msgspec.structs.replace(
            model,
            gravity=model.gravity if axis == down else None,
            **({} if axis == axes[0] else {"position": 0.0, "velocity": 0.0, "hand": still}),
        )
        for axis in axes
    ]


class SeveralAxes:
    """The devices of all axes as one."""

    def __init__(self, parts: Sequence[Part]) -> None:
        self._parts = parts

    @property
    def limits(self) -> DeviceLimits:
        """What each of them can bear."""
        return self._parts[0].limits

    @property
    def target(self) -> Vector:
        """Where the hand pulls the device to during this tick [m]."""
        return _together([part.target for part in self._parts])

    def open(self) -> None:
        """Nothing to connect."""

    def read_position(self, seq: int) -> Vector:
        """Let the time up to a tick pass, then read the encoders."""
        return _together([part.read_position(seq) for part in self._parts])

    def write_force(self, force: Vector, seq: int, offset: float) -> None:
        """Hand over a force: each takes its own part."""
        for part in self._parts:
            part.write_force(force, seq, offset)

    def close(self) -> None:
        """Nothing to disconnect."""


def _together(vectors: Sequence[Vector]) -> Vector:
    x, y, z = (sum(values) for values in zip(*vectors, strict=True))
    return x, y, z
