"""Inputs of a played chain besides its law: forces, targets, arrival times, nudges."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nodes.parameters.store import ParameterError
from sim.arrays import Array


@dataclass(frozen=True, kw_only=True)
class Given:
    """External inputs of a run; None where absent.

    Arrays have shape (ticks,) or (ticks, 3) for one axis, (ticks, 3) for several.
    """

    # force on the device in addition to the law's, per tick [N]
    force: Array | None = None
    # Target of the device's hand during each tick, in place of its path [m].
    target: Array | None = None
    # Arrivals in real time, shape (n,): time, rising [ticks]; the tick answered, −1 for the
    # driver's own force; and that force [N]. None: lockstep. Only for the loop of one axis.
    arrivals: tuple[Array, NDArray[np.int64], Array] | None = None
    # Jumps of position [m], velocity [m/s] and reading [m] at each tick, last axis of length 3.
    nudged: Array | None = None
    # Encoder readings to reproduce [m]: the loop writes the least jumps that do so to `nudged`.
    # Only for the loop of one axis.
    read: Array | None = None
    # Encoder positions, whatever the force [m], shape (ticks, 3).
    path: Array | None = None

    @property
    def any(self) -> bool:
        """Whether the device has an input of its own."""
        return any(
            values is not None for values in (self.force, self.target, self.nudged)
        )

    def along(self, axes: tuple[int, ...], ticks: int, where: str) -> "Given":
        """Return the inputs along three axes; one-axis inputs act along the only one of `axes`.

        Raises
        ------
        ParameterError
            For an array of another shape, and for arrivals.
        """
        if self.arrivals is not None or self.read is not None:
            raise ParameterError(
                "arrivals in real time and readings are given to one rigid device on one axis only",
                path=where,
            )
        return Given(
            force=_spread(self.force, axes, ticks, 2, f"{where}: given.force"),
            target=_spread(self.target, axes, ticks, 2, f"{where}: given.target"),
            nudged=_spread(self.nudged, axes, ticks, 3, f"{where}: given.nudged"),
            path=_spread(self.path, axes, ticks, 2, f"{where}: given.path"),
        )


def _spread(
    values: Array | None, axes: tuple[int, ...], ticks: int, dimensions: int, where: str
) -> Array | None:
    """Return values per tick and axis, with `dimensions` dimensions."""
    if values is None:
        return None
    if values.ndim == dimensions - 1 and len(axes) == 1:
        spread = np.zeros((len(values), 3, *values.shape[1:]))
        spread[:, axes[0]] = values
        values = spread
    shape = (3,) * (dimensions - 1)
    if values.ndim != dimensions or values.shape[1:] != shape or len(values) < ticks:
        raise ParameterError(
            f"shape {values.shape}, expected at least {ticks} rows of {shape}",
            path=where,
        )
    return values
