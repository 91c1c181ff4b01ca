"""What the device can touch: surfaces as a registry, each one a few numbers and the question "where is the proxy?".

A surface answers on plain floats and computes only the axis it lies across. Other packages add
surfaces through the entry points ``haptic.surfaces``.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, Literal, NamedTuple, TypeAlias

import msgspec

from messages.types import ZERO, Vector
from nodes.base.setup import AXIS_INDEX, Axis
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
]


def _wrong_surface(name: str, found: Any) -> str:
    del name
    is_one = isinstance(found, type) and issubclass(found, Surface)
    return "" if is_one else f"{found!r} is not a subclass of nodes.environment.surfaces.Surface"


SURFACES = Registry("haptic.surfaces", "surface", _wrong_surface)

# proxy [m], outward normal, distance [m], contact
Meeting: TypeAlias = tuple[Vector, Vector, float, bool]


class AxisSurface(NamedTuple):
    """A surface as one axis sees it: what one process plays.

    Attributes
    ----------
    shape : str
        ``free``, ``plane`` (one-sided) or ``anchor`` (both sides).
    position : float
        Where it is on that axis [m].
    side : float
        Side of a plane that is free: 1.0 towards larger coordinates, −1.0 towards smaller ones.
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
        Class variable: module of the compiled ticks that meet it.
    """

    kind: ClassVar[str] = ""
    kernel_module: ClassVar[str] = "nodes.environment.kernel"

    def meeting(self) -> Callable[[Vector], Meeting]:
        """Build the question of the hot path.

        Returns
        -------
        callable
            From a device position [m] to proxy, normal, distance and contact.
        """
        numbers = self.numbers(0.0)
        if numbers is None:
            raise TypeError(
                f"surface kind {type(self).kind!r} defines neither numbers() nor meeting()"
            )
        return meeting_of(numbers)

    def meeting_every(self, period: float) -> Callable[[Vector], Meeting]:
        """Build the question of the hot path, for a surface that goes by time.

        Parameters
        ----------
        period : float
            Sampling period [s].

        Returns
        -------
        callable
            As `meeting` does, and what that gives where time does not matter.
        """
        numbers = numbers_of(self, period)
        return self.meeting() if numbers is None else meeting_of(numbers)

    def numbers(self, period: float) -> Numbers | None:
        """Describe the surface by numbers, so that compiled ticks know it too.

        Parameters
        ----------
        period : float
            Sampling period [s].

        Returns
        -------
        Numbers or None
            As nodes/environment/meet.py takes it; None for one that only its own code knows.
        """
        del period
        return None

    def check(self, where: str) -> None:
        """Refuse what cannot be touched, beyond what its fields alone tell, before anything is started.

        Parameters
        ----------
        where : str
            Path of the surface, for errors.
        """

    def pushes(self) -> tuple[Axis, ...] | None:
        """Tell along which axes the surface can push: a scene must compute all of them, or nothing would be felt.

        Returns
        -------
        tuple of str or None
            The axes; None when it is not known beforehand, and looked for at each contact.
        """
        return None

    def on_axis(self, axis: Axis) -> AxisSurface | None:
        """Reduce the surface to one axis, so that one process can play it too.

        Parameters
        ----------
        axis : str
            The axis that the scene computes.

        Returns
        -------
        AxisSurface or None
            The same surface on that axis; None when it is more than that, and only a launch plays
            it.
        """
        del axis
        return None


class Free(Surface, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Nothing to touch: what a device does by itself."""

    kind: ClassVar[str] = "free"

    def numbers(self, period: float) -> Numbers:
        """Describe the surface by numbers."""
        del period
        return Numbers(FREE, array("d"), array("d"))

    def pushes(self) -> tuple[Axis, ...]:
        """Tell along which axes it can push."""
        return ()

    def on_axis(self, axis: Axis) -> AxisSurface:
        """Reduce to one axis."""
        del axis
        return AxisSurface("free")


class Plane(Surface, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A one-sided flat wall or floor across one axis.

    Attributes
    ----------
    axis : str
        Axis that it lies across.
    position : float
        Its coordinate on that axis [m].
    normal : int
        Side that is free: 1 towards larger coordinates (a floor, on z), −1 towards smaller ones.
    """

    kind: ClassVar[str] = "plane"
    axis: Axis = "z"
    position: float = 0.0
    normal: Literal[1, -1] = 1

    def numbers(self, period: float) -> Numbers:
        """Describe the surface by numbers."""
        del period
        return Numbers(
            PLANE, array("d", (AXIS_INDEX[self.axis], self.position, self.normal)), array("d")
        )

    def pushes(self) -> tuple[Axis, ...]:
        """Tell along which axes it can push."""
        return (self.axis,)

    def on_axis(self, axis: Axis) -> AxisSurface:
        """Reduce to one axis."""
        return (
            AxisSurface("plane", self.position, float(self.normal))
            if axis == self.axis
            else AxisSurface("free")
        )


class Anchor(Surface, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A point that holds the device from both sides: the linear loop of the theory, without any contact.

    Attributes
    ----------
    position : tuple of float, shape (3,)
        The point [m].
    """

    kind: ClassVar[str] = "anchor"
    position: Vector = ZERO

    def numbers(self, period: float) -> Numbers:
        """Describe the surface by numbers."""
        del period
        return Numbers(ANCHOR, array("d", self.position), array("d"))

    def pushes(self) -> tuple[Axis, ...]:
        """Tell along which axes a device that is not there is pulled, wherever it moves."""
        return tuple(axis for axis, i in AXIS_INDEX.items() if self.position[i] != 0.0)  # type: ignore[misc]

    def on_axis(self, axis: Axis) -> AxisSurface:
        """Reduce to one axis."""
        return AxisSurface("anchor", self.position[AXIS_INDEX[axis]])


def parse_surface(data: dict[str, Any], where: str) -> Surface:
    """Make a surface from its parameters.

    Parameters
    ----------
    data : dict
        ``kind`` and the fields of that kind.
    where : str
        What the path starts with in errors.

    Returns
    -------
    Surface
        The surface.

    Raises
    ------
    ParameterError
        When the kind is unknown or a field is refused.
    """
    if not isinstance(data, Mapping):
        raise ParameterError(f"{where}: expected a mapping with kind and parameters, got {data!r}")
    try:
        kind = SURFACES.load(data.get("kind", ""))
    except NotInstalledError as error:
        raise ParameterError(f"{where}.kind: {error}") from error
    made: Surface = convert({k: v for k, v in data.items() if k != "kind"}, kind, where)
    return made


def numbers_of(surface: Surface, period: float) -> Numbers | None:
    """Describe a surface by numbers, unless code of its own says how it is met.

    Parameters
    ----------
    surface : Surface
        Any.
    period : float
        Sampling period [s].

    Returns
    -------
    Numbers or None
        None for one that only the interpreter can meet.
    """
    lines = type(surface).__mro__

    def written(name: str) -> int:
        return next(n for n, line in enumerate(lines) if name in vars(line))

    is_described = written("numbers") <= min(written("meeting"), written("meeting_every"))
    return surface.numbers(period) if is_described else None


def meet_axes(surface: Surface, axes: Sequence[str], where: str) -> None:
    """Refuse a surface that pushes where the scene computes no force.

    Parameters
    ----------
    surface : Surface
        The surface.
    axes : sequence of str
        Axes that the scene computes.
    where : str
        Path of the surface, for the error.

    Raises
    ------
    ParameterError
        Naming both.
    """
    left_out = [axis for axis in surface.pushes() or () if axis not in axes]
    if left_out:
        raise ParameterError(
            f"{where}: a {surface.kind} that pushes along {', '.join(left_out)}, but run.axes is"
            f" [{', '.join(axes)}]: nothing would be felt there; name all axes, or leave axes out"
            " and they are taken from the surface"
        )
