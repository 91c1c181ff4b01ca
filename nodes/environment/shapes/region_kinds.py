"""Regions in the registry of surfaces: viscosity, and a line that attracts."""

from __future__ import annotations

import math
from typing import Annotated, Any, ClassVar

import msgspec

from messages.types import Vector
from nodes.base.setup import Effect
from nodes.environment.shapes import scene
from nodes.environment.shapes.kinds import Mesh, Size
from nodes.environment.shapes.scene import FeltRegion, Solid
from nodes.environment.shapes.tables import LINE, VISCOSITY
from nodes.environment.shapes.touchable import Factor, Shape, Touchable
from nodes.environment.surfaces import parse_surface
from nodes.parameters.store import ParameterError


class Viscosity(Touchable, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A region in which the device is slowed down: the proxy trails behind it.

    The law renders no stiffness there, and a damping of its stiffness times `time`. At its boundary
    the effect grows from nothing within `band`.

    Attributes
    ----------
    within : dict
        Kind and parameters of the shape that it fills: sphere, box, capsule, cylinder or
        oriented_plane.
    time : float
        Time by which the proxy trails [s].
    band : float
        Depth over which the effect grows from the boundary [m].
    """

    kind: ClassVar[str] = "viscosity"
    within: dict[str, Any]
    time: Annotated[float, msgspec.Meta(gt=0.0, le=10.0)]
    band: Annotated[float, msgspec.Meta(ge=1e-4, le=1.0)] = 0.002

    def solids(self, where: str) -> list[Solid]:
        """Return none: nothing can be touched."""
        del where
        return []

    def regions(self, where: str) -> list[FeltRegion]:
        """Return the region."""
        at = f"{where}.within"
        shape = parse_surface(self.within, at)
        if not isinstance(shape, Shape) or isinstance(shape, Mesh):
            raise ParameterError(
                f"a region is a sphere, box, capsule, cylinder or oriented_plane, not"
                f" {shape.kind!r}",
                path=f"{at}.kind",
            )
        (solid,) = shape.solids(at)
        odd = [
            name
            for name in ("friction", "stiffness", "damping", "motion")
            if name in self.within
        ]
        if odd:
            raise ParameterError(
                "a region has no surface; leave it out", path=f"{at}.{odd[0]}"
            )
        return [FeltRegion(solid, VISCOSITY, self.band, self.time)]

    def effects(self, where: str) -> list[Effect]:
        """Return the time by which the proxy trails."""
        return [Effect(name=where, lag=self.time)]


class MagneticLine(Touchable, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A line that attracts the device within `reach`, along which it moves freely.

    Up to half of the reach the law acts as on a spring to the line; from there the pull falls off,
    down to nothing at the reach.

    Attributes
    ----------
    start, end : tuple of float, shape (3,)
        Ends of the line [m]; a point attracts if they are the same.
    reach : float
        Distance from which it attracts [m].
    stiffness : float
        Factor of the law, stiffness and damping, at most 1.
    """

    kind: ClassVar[str] = "magnetic_line"
    start: Vector
    end: Vector
    reach: Size
    stiffness: Factor = 1.0

    def solids(self, where: str) -> list[Solid]:
        """Return none: nothing can be touched."""
        del where
        return []

    def regions(self, where: str) -> list[FeltRegion]:
        """Return the line, as a capsule of its reach."""
        del where
        is_point = math.dist(self.start, self.end) < 1e-6
        end = (*self.start[:2], self.start[2] + 1e-6) if is_point else self.end
        shape = scene.capsule(self.start, end, self.reach)
        return [FeltRegion(shape, LINE, strength=self.stiffness)]

    def effects(self, where: str) -> list[Effect]:
        """Return the factor, if it changes the law."""
        factors = {"stiffness": self.stiffness, "damping": self.stiffness}
        return [Effect(name=where, line=True, **factors)]
