"""What a player writes down of a chain: one row a tick, all three axes."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from messages.types import Event
from sim.arrays import Array
from sim.play.one_axis import Trace


@dataclass(frozen=True)
class BodyTrace:
    """Where one thing that moves was at each tick."""

    position: Array  # [m], shape (ticks, 3)
    # Its orientation as a unit quaternion, w first, shape (ticks, 4); None for a point.
    turn: Array | None = None


@dataclass(frozen=True)
class ChainTrace:
    """What happened in a chain, one row a tick; along axes that it does not compute everything is 0."""

    period: float  # sampling period [s]
    axes: tuple[int, ...]  # axes that the chain computes: 0, 1, 2
    position: Array  # true position when sampled [m], shape (ticks, 3)
    velocity: Array  # true velocity when sampled [m/s], shape (ticks, 3)
    measured: Array  # what the encoders read [m], shape (ticks, 3)
    deflection: Array  # newest deflection of the coupling [m], shape (ticks, 3)
    proxy: Array  # where the proxy was [m], shape (ticks, 3)
    # Outward normal of what was touched; zero for a body that moves, shape (ticks, 3).
    normal: Array
    contact: NDArray[np.bool_]  # whether something was touched, shape (ticks,)
    force: Array  # force handed to the device, after all limits [N], shape (ticks, 3)
    law: tuple[str, ...]  # name of the law that rendered each tick
    final: Array  # position [m] and velocity [m/s] after the last tick, shape (2, 3)
    # What moves besides the device, by name: bodies of a MuJoCo scene, the two devices of a pair.
    bodies: Mapping[str, BodyTrace] = field(default_factory=dict)
    events: tuple[Event, ...] = ()  # what its nodes would have published besides their ticks

    @property
    def ticks(self) -> int:
        """Number of ticks."""
        return len(self.position)

    def along(self, axis: int | None = None) -> Trace:
        """Return what happened along an axis, by default the only one that the chain computes."""
        if axis is None:
            (axis,) = self.axes
        rows = (self.position, self.velocity, self.measured, self.deflection, self.force)
        position, velocity, measured, deflection, force = (row[:, axis] for row in rows)
        final = float(self.final[0, axis]), float(self.final[1, axis])
        return Trace(self.period, position, velocity, measured, deflection, force, final)

    @property
    def time(self) -> Array:
        """Sampling instants [s]."""
        return np.arange(self.ticks, dtype=np.float64) * np.float64(self.period)

    @property
    def stopped_at(self) -> int | None:
        """First tick at which the driver had stopped the loop; None where it did not."""
        stops = (event.seq for event in self.events if event.kind == "stopped")
        return next(stops, None)
