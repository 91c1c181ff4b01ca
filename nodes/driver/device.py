"""What a haptic device has to offer to become a driver node: one class, one file.

The driver node (nodes/driver/node.py) owns time, messages and safety; a device only opens, gives
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
    """What the hardware can bear; no launch file can raise it.

    Attributes
    ----------
    peak_force : float
        Largest force on any axis [N].
    continuous_force : float
        Largest root-mean-square force over the thermal time [N].
    slew : float
        Fastest change of force on any axis [N/s].
    silence : float
        Longest time without a fresh force, and oldest force: bounds the driver's watchdog [s].
    hold : float
        How long the device itself holds a force when no other comes, before it lets go [s]: its own
        last line, for a driver that hangs. A driver of hardware without one does not start unless
        the launch file says so.
    lets_go : float or None
        The earliest that it may let go by itself [s], where that is before `hold`: from then on the
        driver takes it to have no force, and brings one back by a ramp. None for `hold`.
    latency : float or None
        From handing a force over until the device applies it [s]: energy and guard account for it.
        None where it is not known, which the driver says; both then take forces to act when they
        are handed over.
    opening, closing : float
        How long `Device.open` and `Device.close` may take [s]; after that the device is taken to
        hang. A launcher that ends its run waits for so long too.
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
    workspace: Workspace = ((-math.inf, math.inf), (-math.inf, math.inf), (-math.inf, math.inf))


class Device(Protocol):
    """A haptic device as the driver node sees it. All calls come from one thread.

    A call that waits must give up the interpreter's lock meanwhile, as ctypes does: a watchdog of
    the driver then notices when it hangs.

    A device whose position may be elsewhere without a motion (re-centred, clutched) counts that in
    an attribute ``jumps``: an integer that another position goes with. Then history begins anew,
    and the force goes from what is felt by a ramp.
    """

    @property
    def limits(self) -> DeviceLimits:
        """What the hardware can bear."""
        ...

    def open(self) -> None:
        """Connect, calibrate with forces off, enable forces at zero.

        Raises
        ------
        OSError
            When the device cannot be used; the text says what to do.
        """
        ...

    def read_position(self, seq: int) -> Vector:
        """Sample the position at a tick.

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
        """Hand a force to the device, which holds it until the next one.

        Parameters
        ----------
        force : tuple of float, shape (3,)
            Force, after all limits [N].
        seq : int
            Tick during which it takes effect.
        offset : float
            Where in that tick, 0 (its start) to 1 [ticks]; hardware, which lives in real time, has
            no use for it.
        """
        ...

    def close(self) -> None:
        """Set zero force and disconnect; called on every way out."""
        ...
