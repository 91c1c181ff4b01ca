"""Surfaces: a registry of what the device can touch, each described by a few numbers.

A surface answers one question, "where is the proxy?", on plain floats, and only for the axis that
it lies across. Other packages add surfaces through the entry points ``haptic.surfaces``.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, Literal, NamedTuple, TypeAlias

import msgspec

from messages.types import ZERO, Vector
from nodes.base.setup import AXIS_INDEX, Axis, Effect
from nodes.environment.meet import Numbers, meeting_of
from nodes.environment.state import ANCHOR, FREE, PLANE
from nodes.parameters.registry import NotInstalledError, Registry
from nodes.parameters.store import ParameterError, convert

__all__ = [
    "SURFACES",
    "Anchor",
    "AxisSurface",
    "Free",
    "Meeting",
    "Plane",
    "Surface",
    "meet_axes",
    "numbers_of",
    "parse_surface",
    "surface_effects",
]


def _wrong_surface(name: str, found: Any) -> str:
    del name
    is_one = isinstance(found, type) and issubclass(found, Surface)
    return (
        ""
        if is_one
        else f"{found!r} is not a subclass of nodes.environment.surfaces.Surface"
    )


SURFACES = Registry("haptic.surfaces", "surface", _wrong_surface)

# proxy [m], outward normal, distance [m], contact
Meeting: TypeAlias = tuple[Vector, Vector, float, bool]


class AxisSurface(NamedTuple):
    """A surface reduced to one axis, for the one-process simulator.

    Attributes
    ----------
    shape : str
        ``free``, ``plane`` (one-sided) or ``anchor`` (both sides).
    position : float
        Coordinate on that axis [m].
    side : float
        Free side of a plane: 1.0 towards larger coordinates, −1.0 towards smaller ones.
    """

    shape: Literal["free", "plane", "anchor"]
    position: float = 0.0
    side: float = 1.0


class Surface(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of all surfaces: the fields of a subclass are its parameters.

    Attributes
    ----------
    kind : str
        Class variable: the registered name.
    kernel_module : str
        Class variable: module of the compiled ticks that can meet it.
    """

    kind: ClassVar[str] = ""
    kernel_module: ClassVar[str] = "nodes.environment.kernel"

    def meeting(self) -> Callable[[Vector], Meeting]:
        """Return the function that finds the proxy for a device position.

        Returns
        -------
        callable
            Maps a device position [m] to proxy [m], outward normal, signed distance [m] and
            contact.
        """
        numbers = self.numbers(0.0)
        if numbers is None:
            raise TypeError(
                f"surface kind {type(self).kind!r} defines neither numbers() nor meeting()"
            )
        return meeting_of(numbers)

    def meeting_every(self, period: float) -> Callable[[Vector], Meeting]:
        """Return the function that finds the proxy, for a surface that depends on time.

        Parameters
        ----------
        period : float
            Sampling period [s].

        Returns
        -------
        callable
            As `meeting` returns; the same function for surfaces that do not depend on time.
        """
        numbers = numbers_of(self, period)
        return self.meeting() if numbers is None else meeting_of(numbers)

    def numbers(self, period: float) -> Numbers | None:
        """Return the surface as numbers, so that compiled ticks can meet it.

        Parameters
        ----------
        period : float
            Sampling period [s].

        Returns
        -------
        Numbers or None
            Arguments of `nodes.environment.meet.meet`; None if only the surface's own code can meet
            it.
        """
        del period
        return None

    def check(self, where: str) -> None:
        """Check the surface before the launch, beyond what its field types check.

        Parameters
        ----------
        where : str
            Parameter path of the surface, for errors.
        """

    def effects(self, where: str) -> list[Effect]:
        """Return what the surface does to a law, for the coupling's checks.

        Parameters
        ----------
        where : str
            Parameter path of the surface.

        Returns
        -------
        list of Effect
            None for a surface on which a law is felt as it is.
        """
        del where
        return []

    def movers(self) -> dict[int, int]:
        """Return the shapes that a topic moves.

        Returns
        -------
        dict of int to int
            Number of each in the parameters to its place among the solids.
        """
        return {}

    def pushes(self) -> tuple[Axis, ...] | None:
        """Return the axes along which the surface can push.

        The scene must compute all of them, or the force along the others would be missing.

        Returns
        -------
        tuple of str or None
            The axes; None if unknown in advance, then each contact is checked.
        """
        return None

    def on_axis(self, axis: Axis) -> AxisSurface | None:
        """Return the surface reduced to one axis, for the one-process simulator.

        Parameters
        ----------
        axis : str
            Axis that the scene computes.

        Returns
        -------
        AxisSurface or None
            The same surface on that axis; None if it cannot be reduced and needs a launch.
        """
        del axis
        return None


class Free(Surface, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Free space: nothing to touch."""

    kind: ClassVar[str] = "free"

    def numbers(self, period: float) -> Numbers:
        """Return the surface as numbers."""
        del period
        return Numbers(FREE, array("d"), array("d"))

    def pushes(self) -> tuple[Axis, ...]:
        """Return no axes."""
        return ()

    def on_axis(self, axis: Axis) -> AxisSurface:
        """Return free space on one axis."""
        del axis
        return AxisSurface("free")


class Plane(Surface, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A one-sided flat wall or floor across one axis.

    Attributes
    ----------
    axis : str
        Axis that it lies across.
    position : float
        Coordinate on that axis [m].
    normal : int
        Free side: 1 towards larger coordinates (a floor, on z), −1 towards smaller ones.
    """

    kind: ClassVar[str] = "plane"
    axis: Axis = "z"
    position: float = 0.0
    normal: Literal[1, -1] = 1

    def numbers(self, period: float) -> Numbers:
        """Return the surface as numbers."""
        del period
        return Numbers(
            PLANE,
            array("d", (AXIS_INDEX[self.axis], self.position, self.normal)),
            array("d"),
        )

    def pushes(self) -> tuple[Axis, ...]:
        """Return the axis that the plane lies across."""
        return (self.axis,)

    def on_axis(self, axis: Axis) -> AxisSurface:
        """Return the plane on its own axis, and free space on the others."""
        return (
            AxisSurface("plane", self.position, float(self.normal))
            if axis == self.axis
            else AxisSurface("free")
        )


class Anchor(Surface, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Spring to a point: pulls the device from both sides, as in linear theory; no contact.

    Attributes
    ----------
    position : tuple of float, shape (3,)
        The point [m].
    """

    kind: ClassVar[str] = "anchor"
    position: Vector = ZERO

    def numbers(self, period: float) -> Numbers:
        """Return the surface as numbers."""
        del period
        return Numbers(ANCHOR, array("d", self.position), array("d"))

    def pushes(self) -> tuple[Axis, ...]:
        """Return the axes on which the point is away from the origin, where the device rests."""
        return tuple(axis for axis, i in AXIS_INDEX.items() if self.position[i] != 0.0)  # type: ignore[misc]

    def on_axis(self, axis: Axis) -> AxisSurface:
        """Return the anchor on one axis."""
        return AxisSurface("anchor", self.position[AXIS_INDEX[axis]])


def parse_surface(data: dict[str, Any], where: str) -> Surface:
    """Return the surface that parameters describe.

    Parameters
    ----------
    data : dict
        ``kind`` and the fields of that kind.
    where : str
        Parameter path, the beginning of every error.

    Returns
    -------
    Surface
        The surface.

    Raises
    ------
    ParameterError
        If the kind is unknown or a field is invalid.
    """
    if not isinstance(data, Mapping):
        raise ParameterError(
            f"expected a mapping with kind and parameters, got {data!r}", path=where
        )
    try:
        kind = SURFACES.load(data.get("kind", ""))
    except NotInstalledError as error:
        raise ParameterError(str(error), path=f"{where}.kind") from error
    made: Surface = convert({k: v for k, v in data.items() if k != "kind"}, kind, where)
    return made


def surface_effects(data: dict[str, Any], where: str) -> list[Effect]:
    """Return what the surface of these parameters does to a law (`nodes.base.setup.Effect`).

    Parameters
    ----------
    data : dict
        ``kind`` and the fields of that kind.
    where : str
        Parameter path of the surface.

    Returns
    -------
    list of Effect
        One for each shape or region that changes a law.
    """
    return parse_surface(data, where).effects(where)


def numbers_of(surface: Surface, period: float) -> Numbers | None:
    """Return a surface as numbers, unless the surface has its own code to meet it.

    Parameters
    ----------
    surface : Surface
        The surface.
    period : float
        Sampling period [s].

    Returns
    -------
    Numbers or None
        None if only the interpreter can meet the surface.
    """
    lines = type(surface).__mro__

    def written(name: str) -> int:
        return next(n for n, line in enumerate(lines) if name in vars(line))

    is_described = written("numbers") <= min(
        written("meeting"), written("meeting_every")
    )
    return surface.numbers(period) if is_described else None


def meet_axes(surface: Surface, axes: Sequence[str], where: str) -> None:
    """Check that the scene computes every axis along which a surface pushes.

    Parameters
    ----------
    surface : Surface
        The surface.
    axes : sequence of str
        Axes that the scene computes.
    where : str
        Parameter path of the surface, for errors.

    Raises
    ------
    ParameterError
        If an axis is missing.
    """
    left_out = [axis for axis in surface.pushes() or () if axis not in axes]
    if left_out:
        raise ParameterError(
            f"a {surface.kind} that pushes along {', '.join(left_out)}, but run.axes is"
            f" [{', '.join(axes)}]: nothing would be felt there; name all axes, or leave axes out"
            " and they are taken from the surface",
            path=where,
        )
