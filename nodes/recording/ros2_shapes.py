"""Shapes of RViz markers for the surfaces of a scene."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple, TypeAlias

from messages.types import Vector
from nodes.base.setup import AXIS_INDEX

CUBE, SPHERE, CYLINDER = 1, 2, 3  # visualization_msgs/msg/Marker.type
ACROSS, THICK = 0.3, 0.002  # drawn extent and thickness of a plane [m]

Quaternion: TypeAlias = tuple[float, float, float, float]  # x, y, z, w
NOT_TURNED: Quaternion = (0.0, 0.0, 0.0, 1.0)


class MarkerShape(NamedTuple):
    """One marker: type, centre [m], extents along its own axes [m], orientation."""

    shape: int
    position: Vector
    size: Vector
    turn: Quaternion = NOT_TURNED


def drawn_shapes(surface: Any) -> list[MarkerShape]:
    """Return the markers of a surface's parameters; of a mesh or a moving shape, none.

    A plane is drawn as a thin plate whose free side is the surface that is touched.
    """
    if not isinstance(surface, Mapping) or surface.get("motion"):
        return []
    kind = surface.get("kind")
    if kind == "union":
        return [one for part in surface.get("shapes", ()) for one in drawn_shapes(part)]
    if kind == "plane":
        normal = [0.0, 0.0, 0.0]
        axis = AXIS_INDEX[surface.get("axis", "z")]
        normal[axis] = float(surface.get("normal", 1))
        place = [0.0, 0.0, 0.0]
        place[axis] = float(surface.get("position", 0.0))
        return [_plate(place, normal)]
    if kind in ("capsule", "cylinder"):
        return _rod(surface, kind == "capsule")
    place = surface.get("position", (0.0, 0.0, 0.0))
    if kind == "oriented_plane":
        return [_plate(place, surface.get("normal", (0.0, 0.0, 1.0)))]
    if kind == "sphere":
        return [MarkerShape(SPHERE, _vector(place), (2.0 * surface["radius"],) * 3)]
    if kind == "box":
        turn = surface.get("rotation", (0.0, 0.0, 0.0))
        return [
            MarkerShape(CUBE, _vector(place), _vector(surface["size"]), turned_by(turn))
        ]
    return []


def _vector(values: Any) -> Vector:
    x, y, z = map(float, values)
    return x, y, z


def _plate(place: Any, normal: Any) -> MarkerShape:
    """Return the plate below a plane through `place`."""
    length = math.hypot(*normal)
    unit = _vector(part / length for part in normal)
    centre = _vector(
        at - 0.5 * THICK * part for at, part in zip(place, unit, strict=True)
    )
    return MarkerShape(CUBE, centre, (ACROSS, ACROSS, THICK), from_z_to(unit))


def _rod(surface: Mapping[str, Any], with_ends: bool) -> list[MarkerShape]:
    """Return a cylinder, of a capsule with the balls at its ends."""
    start = _vector(surface["start"])
    end = _vector(surface["end"])
    length = math.dist(start, end)
    wide = 2.0 * surface["radius"]
    centre = _vector(0.5 * (a + b) for a, b in zip(start, end, strict=True))
    unit = _vector((b - a) / length for a, b in zip(start, end, strict=True))
    ends = (
        [MarkerShape(SPHERE, at, (wide,) * 3) for at in (start, end)]
        if with_ends
        else []
    )
    return [MarkerShape(CYLINDER, centre, (wide, wide, length), from_z_to(unit)), *ends]


def from_z_to(unit: Vector) -> Quaternion:
    """Return the shortest rotation that turns the z axis to a unit vector."""
    x, y, z = unit
    if z <= -1.0 + 1e-12:
        return 1.0, 0.0, 0.0, 0.0
    w = math.sqrt(0.5 * (1.0 + z))
    return -0.5 * y / w, 0.5 * x / w, 0.0, w


def turned_by(turn: Any) -> Quaternion:
    """Return the rotation of roll, pitch and yaw about the fixed axes [rad], as in URDF."""
    (a, b, c), (d, e, f) = (
        [function(0.5 * angle) for angle in turn] for function in (math.cos, math.sin)
    )
    return (
        d * b * c - a * e * f,
        a * e * c + d * b * f,
        a * b * f - d * e * c,
        a * b * c + d * e * f,
    )
