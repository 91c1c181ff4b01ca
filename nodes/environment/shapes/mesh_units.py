"""Units of mesh files: no format but 3MF says one, so a scene does, and is told the width."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, NamedTuple

from nodes.environment.shapes.mesh import LARGEST, SMALLEST
from nodes.parameters.store import ParameterError

UNITS: Final = {
    "mm": 1e-3,
    "cm": 1e-2,
    "inch": 0.0254,
    "m": 1.0,
    "foot": 0.3048,
    "µm": 1e-6,
}  # [m]
LIKELY: Final = (0.02, 0.5)  # width of what a hand feels [m]


class UnitCandidate(NamedTuple):
    """A unit in which a scene could take the file."""

    unit: str
    scale: float  # of the scene [m per unit]
    width: float  # [m]
    is_likely: bool  # whether a hand would feel something of that width


def unit_candidates(width: float) -> list[UnitCandidate]:
    """Return the units in which a width is one that a scene accepts, likely ones first."""
    found = [
        UnitCandidate(
            unit, scale, width * scale, LIKELY[0] <= width * scale <= LIKELY[1]
        )
        for unit, scale in UNITS.items()
        if SMALLEST <= width * scale <= LARGEST
    ]
    return sorted(found, key=lambda one: not one.is_likely)


def scale_of(
    width: float, given: Mapping[str, Any], where: str, named_by_file: str = ""
) -> tuple[float, str]:
    """Return metres per unit of a file, and how wide the mesh is by that, as text.

    Parameters
    ----------
    width : float
        Largest extent of the mesh in the file [units].
    given : mapping
        At most one of ``unit`` of the file, ``scale`` [m per unit] and ``width`` [m].
    where : str
        Parameter path of the mesh, for errors.
    named_by_file : str
        Unit that the file names; empty for none.

    Raises
    ------
    ParameterError
        If more than one is given, or the mesh would be too small or too large.
    """
    if len(given) > 1:
        raise ParameterError(
            f"{' and '.join(given)} each give the size of the mesh; leave all but one out",
            path=where,
        )
    if "unit" in given:
        unit = given["unit"]
        per_unit = UNITS["µm" if unit == "um" else unit]
        how = f"unit {unit}"
    elif "width" in given:
        per_unit = given["width"] / width if width > 0.0 else 1.0
        how = f"width {given['width']:g} m"
    elif "scale" in given:
        per_unit = given["scale"]
        how = f"scale {given['scale']:g}"
    else:
        per_unit, how = 1.0, "taken in metres, because no unit, scale or width is given"
    extent = width * per_unit
    if not SMALLEST <= extent <= LARGEST and width > 0.0:
        fitting = [
            f"unit: {one.unit} ({one.width:.3g} m)" for one in unit_candidates(width)
        ]
        remedy = (
            f"set {', '.join(fitting)}" if fitting else "set width, e.g. width: 0.08"
        )
        raise ParameterError(
            f"the mesh is {extent:.4g} m wide ({width:.4g} units, {how}), expected"
            f" {SMALLEST:g} to {LARGEST:g} m; {remedy}, or width: 0.08 for 80 mm",
            path=where,
        )
    if named_by_file:
        how += f"; the file names {named_by_file}"
    return per_unit, f"{extent * 1e3:.4g} mm wide ({width:.4g} units, {how})"
