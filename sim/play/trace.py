"""Record of a played chain: one row per tick, all three axes."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from messages.types import Event
from sim.arrays import Array
from sim.play.one_axis import Trace


@dataclass(frozen=True)
class BodyTrace:
    """Trajectory of one moving thing."""

    position: Array  # position [m], shape (ticks, 3)
    # Its orientation as a unit quaternion, w first, shape (ticks, 4); None for a point.
    turn: Array | None = None


@dataclass(frozen=True)
class ChainTrace:
    """Record of a chain, one row per tick; axes that are not computed are 0."""

    period: float  # sampling period [s]
    axes: tuple[int, ...]  # computed axes: 0, 1, 2
    position: Array  # true position when sampled [m], shape (ticks, 3)
    velocity: Array  # true velocity when sampled [m/s], shape (ticks, 3)
    measured: Array  # encoder readings [m], shape (ticks, 3)
    deflection: Array  # newest deflection of the coupling [m], shape (ticks, 3)
    proxy: Array  # proxy position [m], shape (ticks, 3)
    # Outward normal of the touched surface; zero for a moving body, shape (ticks, 3).
    normal: Array
    contact: NDArray[np.bool_]  # whether a surface is touched, shape (ticks,)
    force: Array  # force passed to the device, after all limits [N], shape (ticks, 3)
    law: tuple[str, ...]  # name of the rendered law at each tick
    final: Array  # position [m] and velocity [m/s] after the last tick, shape (2, 3)
    # Other moving things by name: bodies of a MuJoCo scene, the two devices of a pair.
    bodies: Mapping[str, BodyTrace] = field(default_factory=dict)
    events: tuple[Event, ...] = ()  # events of its nodes

    @property
    def ticks(self) -> int:
        """Number of ticks."""
        return len(self.position)

    def along(self, axis: int | None = None) -> Trace:
        """Return the record of one axis, by default the only computed one."""
        if axis is None:
            (axis,) = self.axes
        rows = (
            self.position,
            self.velocity,
            self.measured,
            self.deflection,
            self.force,
        )
        position, velocity, measured, deflection, force = (row[:, axis] for row in rows)
        final = float(self.final[0, axis]), float(self.final[1, axis])
        return Trace(
            self.period, position, velocity, measured, deflection, force, final
        )

    @property
    def time(self) -> Array:
        """Sampling instants [s]."""
        return np.arange(self.ticks, dtype=np.float64) * np.float64(self.period)

    @property
    def stopped_at(self) -> int | None:
        """First tick with the driver stopped; None if it never stopped."""
        stops = (event.seq for event in self.events if event.kind == "stopped")
        return next(stops, None)
