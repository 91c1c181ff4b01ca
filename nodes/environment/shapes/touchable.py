"""What shapes share: solids and regions, proxies with memory, factors, friction, motion."""

from __future__ import annotations

from typing import Annotated, ClassVar, Final

import msgspec

from nodes.base.setup import Axis, Effect
from nodes.environment.meet import Numbers
from nodes.environment.shapes import scene
from nodes.environment.shapes.motion_parameters import MotionParameters, motion_of
from nodes.environment.shapes.scene import WHOLE, Factors, FeltRegion, Friction, Solid
from nodes.environment.state import SHAPES
from nodes.environment.surfaces import Surface

__all__ = ["TOOL_RADIUS", "Factor", "FrictionParameters", "Shape", "Touchable"]

TOOL_RADIUS: Final = 1e-5  # default radius of the tool [m]
Coefficient = Annotated[float, msgspec.Meta(ge=0.0, le=100.0)]
Factor = Annotated[float, msgspec.Meta(ge=0.0, le=1.0)]


class FrictionParameters(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True
):
    """Friction of a surface.

    Attributes
    ----------
    static : float
        Coefficient up to which the proxy sticks: tangential over normal deflection.
    dynamic : float or None
        Coefficient while it slides; None for the static one.
    viscous : float
        Time by which a sliding proxy trails [s]; times the coupling's stiffness, this is a viscous
        friction.
    """

    static: Coefficient = 0.0
    dynamic: Coefficient | None = None
    viscous: Coefficient = 0.0

    def __post_init__(self) -> None:
        if self.dynamic is not None and self.dynamic > self.static:
            raise ValueError(
                f"dynamic is {self.dynamic}, expected at most static, {self.static}"
            )


class Touchable(Surface, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of surfaces in three dimensions.

    Attributes
    ----------
    tool_radius : float
        Radius of the ball that touches [m]. 0 is a point, which catches on steps of nanometres
        between solids that are meant to be flush.
    """

    kernel_module: ClassVar[str] = "nodes.environment.shapes.kernel"
    tool_radius: Annotated[float, msgspec.Meta(ge=0.0, le=0.1)] = TOOL_RADIUS

    def solids(self, where: str) -> list[Solid]:
        """Return the solids that the geometry works on.

        Parameters
        ----------
        where : str
            Parameter path of the surface, for errors.

        Returns
        -------
        list of Solid
            At least one.

        Raises
        ------
        ParameterError
            If a parameter is invalid.
        """
        raise TypeError(
            f"{where}: surface kind {type(self).kind!r} does not define solids()"
        )

    def regions(self, where: str) -> list[FeltRegion]:
        """Return the regions without a surface.

        Parameters
        ----------
        where : str
            Parameter path of the surface, for errors.

        Returns
        -------
        list of FeltRegion
            None for a surface that can be touched everywhere.
        """
        del where
        return []

    def movers(self) -> dict[int, int]:
        """Return the shapes that a topic moves: number in parameters to place among solids."""
        return {}

    def check(self, where: str) -> None:
        """Check that solids and regions can be made."""
        self.solids(where)
        self.regions(where)

    def numbers(self, period: float) -> Numbers:
        """Return the scene table and the memory of a proxy that has touched nothing yet."""
        solids = self.solids("surface")
        repairs = tuple(
            repair
            for solid in solids
            if solid.mesh is not None
            for repair in solid.mesh.repairs
        )
        return Numbers(
            SHAPES,
            scene.scene_table(
                solids, self.tool_radius, period, self.regions("surface")
            ),
            scene.new_memory(len(solids)),
            repairs,
            tuple(solid.mesh.width for solid in solids if solid.mesh is not None),
        )

    def pushes(self) -> tuple[Axis, ...]:
        """Return all axes."""
        return ("x", "y", "z")


class Shape(Touchable, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of single shapes.

    Attributes
    ----------
    friction : FrictionParameters
        Without friction by default.
    stiffness : float
        Factor of the law's stiffness on this shape, at most 1: the law as it is.
    damping : float or None
        Factor of the rest of the law, its damping; None for the same factor.
    motion : MotionParameters or None
        How it moves; None for a shape that stays.
    """

    friction: FrictionParameters = FrictionParameters()
    stiffness: Factor = 1.0
    damping: Factor | None = None
    motion: MotionParameters | None = None

    def felt(self, solid: Solid) -> list[Solid]:
        """Return a `solid` with the factors and the motion of this shape.

        Returns
        -------
        list of Solid
            Only this one.
        """
        return [solid._replace(factors=self._factors, motion=motion_of(self.motion))]

    def movers(self) -> dict[int, int]:
        """Return this shape, if it moves without a path."""
        return {0: 0} if self.motion is not None and not self.motion.path else {}

    @property
    def _factors(self) -> Factors:
        return Factors(
            self.stiffness, self.stiffness if self.damping is None else self.damping
        )

    def effects(self, where: str) -> list[Effect]:
        """Return the factors, if they change the law."""
        return (
            []
            if self._factors == WHOLE
            else [Effect(name=where, **self._factors._asdict())]
        )

    @property
    def coefficients(self) -> Friction:
        """Friction coefficients with defaults filled in."""
        given = self.friction
        return Friction(
            given.static,
            given.static if given.dynamic is None else given.dynamic,
            given.viscous,
        )
