"""Shapes in the registry of surfaces: single ones, and unions of them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import msgspec

from messages.types import ZERO, Vector
from nodes.base.setup import Effect
from nodes.environment.shapes import scene
from nodes.environment.shapes.region_overlap import overlap_effects
from nodes.environment.shapes.scene import FeltRegion, Solid
from nodes.environment.shapes.touchable import Shape, Touchable
from nodes.environment.surfaces import parse_surface
from nodes.parameters.store import ParameterError

__all__ = [
    "Ball",
    "Box",
    "Capsule",
    "Cylinder",
    "Mesh",
    "OrientedPlane",
    "Size",
    "Union",
]

Unit = Literal["m", "cm", "mm", "µm", "um", "inch", "foot"]
Size = Annotated[float, msgspec.Meta(gt=0.0, le=1e6)]
Sizes = tuple[Size, Size, Size]


class OrientedPlane(Shape, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Half space below a plane of any orientation.

    Attributes
    ----------
    position : tuple of float, shape (3,)
        A point of the plane [m].
    normal : tuple of float, shape (3,)
        Direction of the free side, of any length.
    """

    kind: ClassVar[str] = "oriented_plane"
    position: Vector = ZERO
    normal: Vector = (0.0, 0.0, 1.0)

    def solids(self, where: str) -> list[Solid]:
        """Return the half space."""
        if math.hypot(*self.normal) < 1e-6:
            raise ParameterError(
                f"{list(self.normal)} has no direction", path=f"{where}.normal"
            )
        return self.felt(scene.plane(self.position, self.normal, self.coefficients))


class Ball(Shape, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A sphere, touched from outside.

    Attributes
    ----------
    position : tuple of float, shape (3,)
        Centre [m].
    radius : float
        Radius [m].
    """

    kind: ClassVar[str] = "sphere"
    position: Vector = ZERO
    radius: Size

    def solids(self, where: str) -> list[Solid]:
        """Return the sphere."""
        del where
        return self.felt(scene.sphere(self.position, self.radius, self.coefficients))


class Box(Shape, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A box, touched from outside.

    Attributes
    ----------
    position : tuple of float, shape (3,)
        Centre [m].
    size : tuple of float, shape (3,)
        Lengths of its edges [m].
    rotation : tuple of float, shape (3,)
        Roll, pitch and yaw about the fixed axes [rad], as in URDF.
    """

    kind: ClassVar[str] = "box"
    position: Vector = ZERO
    size: Sizes
    rotation: Vector = ZERO

    def solids(self, where: str) -> list[Solid]:
        """Return the box."""
        del where
        return self.felt(
            scene.box(self.position, self.size, self.rotation, self.coefficients)
        )


class _Rod(Shape, frozen=True, forbid_unknown_fields=True, kw_only=True):
    start: Vector
    end: Vector
    radius: Size

    def solids(self, where: str) -> list[Solid]:
        """Return the solid between the two ends."""
        if math.dist(self.start, self.end) < 1e-6:
            raise ParameterError(
                f"{list(self.end)} is the start: the axis has no direction; a ball is a sphere",
                path=f"{where}.end",
            )
        make = scene.capsule if type(self).kind == "capsule" else scene.cylinder
        return self.felt(make(self.start, self.end, self.radius, self.coefficients))


class Capsule(_Rod, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A capsule: all points within a radius of a straight line.

    Attributes
    ----------
    start, end : tuple of float, shape (3,)
        Ends of the line [m].
    radius : float
        Radius [m].
    """

    kind: ClassVar[str] = "capsule"


class Cylinder(_Rod, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A cylinder, touched from outside.

    Attributes
    ----------
    start, end : tuple of float, shape (3,)
        Centres of its two ends [m].
    radius : float
        Radius [m].
    """

    kind: ClassVar[str] = "cylinder"


class Mesh(Shape, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A solid bounded by triangles, or a sheet of them.

    Attributes
    ----------
    file : str
        An ``.stl``, ``.obj``, ``.ply`` or ``.off`` file, or with the extra ``meshes`` a ``.3mf``,
        ``.glb`` or ``.gltf``; ``$(dirname)`` in a launch file is the
        folder of that file.
    unit : str or None
        Unit of the file: m, cm, mm, µm (um), inch or foot.
    scale : float or None
        Metres per unit of the file, in place of `unit`: 0.001 for millimetres.
    width : float or None
        Largest extent that the mesh has in the scene, in place of both [m]. Without any of the
        three the file is in the unit that it names (3MF, glTF), or in metres; an event says the
        width.
    position : tuple of float, shape (3,)
        Position of the file's origin [m].
    rotation : tuple of float, shape (3,)
        Roll, pitch and yaw [rad].
    sides : str
        ``outer`` for a closed mesh, felt from outside; ``both`` for a sheet, which may be open.
    """

    kind: ClassVar[str] = "mesh"
    file: str
    unit: Unit | None = None
    scale: Size | None = None
    width: Size | None = None
    position: Vector = ZERO
    rotation: Vector = ZERO
    sides: Literal["outer", "both"] = "outer"

    def _sizes(self, unit: str) -> dict[str, Any]:
        """Return what gives the size: the parameters, else the unit that the file names."""
        given = {"unit": self.unit, "scale": self.scale, "width": self.width}
        found = {name: value for name, value in given.items() if value is not None}
        return found or ({"unit": unit} if unit else {})

    def solids(self, where: str) -> list[Solid]:
        """Read the file and return the solid."""
        import numpy as np  # a scene of plain shapes needs no numpy

        from nodes.environment.shapes.mesh import prepare_mesh
        from nodes.environment.shapes.mesh_file import read_mesh
        from nodes.environment.shapes.mesh_units import scale_of

        file = Path(self.file).expanduser()
        read = read_mesh(file, f"{where}.file")
        with np.errstate(over="ignore", invalid="ignore"):
            width = float(np.ptp(read.corners.reshape(-1, 3), axis=0).max())
            per_unit, told = (
                scale_of(
                    width, self._sizes(read.unit), f"{where}.file: {file}", read.unit
                )
                if np.isfinite(width)
                else (1.0, "")
            )
            corners = (
                per_unit * read.corners @ np.array(scene.rotation(self.rotation)).T
                + self.position
            )
        made = prepare_mesh(
            corners, self.sides == "both", f"{where}.file: {file}", read.notes
        )
        made = made._replace(width=f"{where}.file: {file} is {told}")
        return self.felt(scene.mesh(made, self.coefficients))


class Union(Touchable, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Several shapes touched as one surface, also at the same time; and regions between them.

    Attributes
    ----------
    shapes : list of dict
        Kind and parameters of each.
    """

    kind: ClassVar[str] = "union"
    shapes: Annotated[list[dict[str, Any]], msgspec.Meta(min_length=1, max_length=64)]

    def solids(self, where: str) -> list[Solid]:
        """Return the solids of all shapes."""
        return [solid for at, part in self._parts(where) for solid in part.solids(at)]

    def regions(self, where: str) -> list[FeltRegion]:
        """Return the regions of all shapes."""
        return [
            region for at, part in self._parts(where) for region in part.regions(at)
        ]

    def effects(self, where: str) -> list[Effect]:
        """Return what all shapes do to a law, and regions where several of them act."""
        found: list[Effect] = []
        regions: list[FeltRegion] = []
        acting: list[Effect] = []
        for at, part in self._parts(where):
            effects = part.effects(at)
            own = part.regions(at)
            found += effects
            if own:
                regions += own
                acting += effects
        return found + overlap_effects(regions, acting)

    def movers(self) -> dict[int, int]:
        """Return the shapes that a topic moves: place in `shapes` to place among solids."""
        solids = [
            (i, part)
            for i, (_, part) in enumerate(self._parts("surface"))
            if isinstance(part, Shape)
        ]
        return {i: n for n, (i, part) in enumerate(solids) if part.movers()}

    def _parts(self, where: str) -> Iterator[tuple[str, Touchable]]:
        """Yield each part with its parameter path; ParameterError if it cannot be a part."""
        for i, data in enumerate(self.shapes):
            at = f"{where}.shapes[{i}]"
            shape = parse_surface(data, at)
            if not isinstance(shape, Touchable) or isinstance(shape, Union):
                raise ParameterError(
                    f"{shape.kind!r} is no shape that can be part of a union",
                    path=f"{at}.kind",
                )
            if "tool_radius" in data:
                raise ParameterError(
                    "the tool has one radius; set it on the union",
                    path=f"{at}.tool_radius",
                )
            yield at, shape
