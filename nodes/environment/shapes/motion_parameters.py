"""Parameters of a shape that moves."""

from __future__ import annotations

import math
from typing import Annotated

import msgspec

from nodes.environment.shapes.scene import ShapeMotion

WayPoint = tuple[float, float, float, float]


class MotionParameters(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True
):
    """ShapeMotion of a shape, relative to its place in the launch file.

    Attributes
    ----------
    path : list of tuple of float, shape (N, 4)
        Time since tick 0 [s] and offset along x, y, z [m], straight between two rows. Empty for a
        shape that moves to where ``haptic topic pub /external/shape`` puts it.
    repeat : float or None
        Time after which the path begins again [s]; None for never.
    speed : float
        Largest speed [m/s]. A path must not ask for more.
    power : float
        Largest power that the shape puts into the device [W]. It slows down where it would put in
        more, and catches up later.
    """

    path: Annotated[list[WayPoint], msgspec.Meta(max_length=100_000)] = []
    repeat: Annotated[float, msgspec.Meta(gt=0.0, le=1e6)] | None = None
    speed: Annotated[float, msgspec.Meta(gt=0.0, le=1.0)] = 0.1
    power: Annotated[float, msgspec.Meta(gt=0.0, le=100.0)] = 0.5

    def __post_init__(self) -> None:
        """Check that the path can be followed."""
        if self.repeat is not None and self.path and self.path[-1][0] > self.repeat:
            raise ValueError(
                f"path ends at {self.path[-1][0]:g} s, expected at most repeat, {self.repeat:g} s"
            )
        for i, (a, b) in enumerate(zip(self.path, self.path[1:], strict=False)):
            way = math.dist(a[1:], b[1:])
            span = b[0] - a[0]
            if not span > 0.0:
                raise ValueError(
                    f"path[{i + 1}] is at {b[0]:g} s, expected later than {a[0]:g} s"
                )
            if way > self.speed * span * (1.0 + 1e-9):
                raise ValueError(
                    f"path[{i + 1}] asks for {way / span:.3g} m/s, limit speed, {self.speed:g} m/s;"
                    " give it more time or raise speed (at most 1 m/s)"
                )


def motion_of(given: MotionParameters | None) -> ShapeMotion | None:
    """Return the motion as the geometry uses it; None for a shape that stays."""
    if given is None:
        return None
    return ShapeMotion(given.speed, given.power, tuple(given.path), given.repeat or 0.0)
