"""What happens to a played chain besides its law: forces, a led hand, arrivals in real time, nudges."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nodes.parameters.store import ParameterError
from sim.arrays import Array


@dataclass(frozen=True, kw_only=True)
class Given:
    """What happens to a run beside its scene and law; None for what does not.

    Of a scene of one axis an array has shape (ticks,) or (ticks, 3); of several axes (ticks, 3).
    """

    force: Array | None = None  # force on the device besides the law's, during each tick [N]
    # Where the device's hand pulls to during each tick instead of along its path [m].
    target: Array | None = None
    # When the driver gets forces in real time, shape (n,), rising [ticks]; the tick that each
    # answers, −1 for the driver's own; and the latter's value [N]. None for lockstep: each tick's
    # own, by the rule. Only the loop of one axis plays them.
    arrivals: tuple[Array, NDArray[np.int64], Array] | None = None
    # Jumps of position [m], velocity [m/s] and reading [m] at each tick, last axis of length 3.
    nudged: Array | None = None
    # What an encoder has read [m]: the least jumps that keep the device there are noted in
    # `nudged`. Only the loop of one axis finds them.
    read: Array | None = None
    # Where the encoders find the device whatever the force [m], shape (ticks, 3).
    path: Array | None = None

    @property
    def any(self) -> bool:
        """Whether something acts on the device itself."""
        return any(values is not None for values in (self.force, self.target, self.nudged))

    def along(self, axes: tuple[int, ...], ticks: int, where: str) -> "Given":
        """Return it along all three axes; what has one axis acts along the only one of `axes`.

        Raises
        ------
        ParameterError
            For an array of another shape, and for arrivals.
        """
        if self.arrivals is not None or self.read is not None:
            raise ParameterError(
                f"{where}: arrivals in real time and readings are given to one rigid device on one"
                " axis only"
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
    """Return values a tick and axis, of so many dimensions."""
    if values is None:
        return None
    if values.ndim == dimensions - 1 and len(axes) == 1:
        spread = np.zeros((len(values), 3, *values.shape[1:]))
        spread[:, axes[0]] = values
        values = spread
    shape = (3,) * (dimensions - 1)
    if values.ndim != dimensions or values.shape[1:] != shape or len(values) < ticks:
        raise ParameterError(
            f"{where}: shape {values.shape}, expected at least {ticks} rows of {shape}"
        )
    return values
