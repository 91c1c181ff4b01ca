"""Interface of a haptic device: one class in one file becomes a driver node.

The driver node (nodes/driver/node.py) owns time, messages and safety; a device only opens, returns
positions, takes forces and closes. A real one wraps its vendor's library; the virtual one is
sim/device/driver.py.
"""

from __future__ import annotations

import math
from typing import Protocol, TypeAlias

import msgspec

from messages.types import Vector

__all__ = ["Bounds", "Device", "DeviceLimits", "Workspace"]

Bounds: TypeAlias = tuple[float, float]
Workspace: TypeAlias = tuple[Bounds, Bounds, Bounds]


class DeviceLimits(msgspec.Struct, frozen=True, kw_only=True):
    """Limits of the hardware, which no launch file can raise.

    Attributes
    ----------
    peak_force : float
        Largest force on any axis [N].
    continuous_force : float
        Largest root-mean-square force over the thermal time [N].
    slew : float
        Fastest change of force on any axis [N/s].
    silence : float
        Longest time without a fresh force, and oldest force: limits the driver's watchdog [s].
    hold : float
        Time after which the device itself sets an old force to zero [s], in case the driver hangs.
        A driver of hardware without it starts only if the launch file allows it.
    lets_go : float or None
        Earliest time at which it may do so [s], if before `hold`: from then on the driver assumes
        that there is no force, and ramps one up. None for `hold`.
    latency : float or None
        Time from handing a force over until the device applies it [s], used by energy and guard.
        None if unknown, which the driver reports; then forces count from when they are handed over.
    opening, closing : float
        Longest duration of `Device.open` and `Device.close` [s], after which the device counts as
        hanging. A launcher that ends its run waits as long.
    workspace : tuple of tuple of float, shape (3, 2)
        Smallest and largest coordinate of each axis [m].
    """

    peak_force: float = math.inf
    continuous_force: float = math.inf
    slew: float = math.inf
    silence: float = math.inf
    hold: float = math.inf
    lets_go: float | None = None
    latency: float | None = None
    opening: float = 20.0
    closing: float = 2.0
    workspace: Workspace = (
        (-math.inf, math.inf),
        (-math.inf, math.inf),
        (-math.inf, math.inf),
    )


class Device(Protocol):
    """A haptic device as the driver node uses it. All calls come from one thread.

    A blocking call must release the GIL, as ctypes does, so that the driver's watchdog can notice
    when it hangs.

    A device whose position may change without motion (re-centred, clutched) counts such jumps in an
    integer attribute ``jumps``. The history then restarts, and the force changes by a ramp.
    """

    @property
    def limits(self) -> DeviceLimits:
        """Limits of the hardware."""
        ...

    def open(self) -> None:
        """Connect, calibrate with forces off, enable forces at zero.

        Raises
        ------
        OSError
            If the device cannot be used; the text has the remedy.
        """
        ...

    def read_position(self, seq: int) -> Vector:
        """Return the position at a tick.

        Parameters
        ----------
        seq : int
            Tick number; larger than at the call before.

        Returns
        -------
        tuple of float, shape (3,)
            Position [m].
        """
        ...

    def write_force(self, force: Vector, seq: int, offset: float) -> None:
        """Apply a force until the next one.

        Parameters
        ----------
        force : tuple of float, shape (3,)
            Force, after all limits [N].
        seq : int
            Tick during which it takes effect.
        offset : float
            Time within that tick, 0 (its start) to 1 [ticks]; of no use to hardware, which runs in
            real time.
        """
        ...

    def close(self) -> None:
        """Set zero force and disconnect; called on every way out."""
        ...
