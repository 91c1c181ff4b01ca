"""What a mesh file is, before a scene uses it: widths, shells, holes, repairs, verdict."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import NamedTuple

import numpy as np

from nodes.environment.shapes.mesh import refuse_no_solid, repaired_triangles
from nodes.environment.shapes.mesh_edges import rims
from nodes.environment.shapes.mesh_file import ReadMesh, read_mesh
from nodes.environment.shapes.mesh_holes import Hole, holes
from nodes.environment.shapes.mesh_repair import NARROW, SLIVER, Repaired, repair
from nodes.environment.shapes.mesh_shells import winding_number
from nodes.environment.shapes.mesh_units import UnitCandidate, unit_candidates
from nodes.environment.shapes.polygons import Coordinates, Ids
from nodes.parameters.store import ParameterError

_PROBES = (64, 400)  # least and most places of its faces that are probed for crossings
_WORK = 4_000_000  # triangles times places, above the least number of places
_WIDTH = 0.08  # assumed width where no unit gives a likely one [m]
_WIDEST = 1e30  # largest width, whose cube is still a number [units]
_OFF_FACE = 1e-6  # distance of a probed place from its face [of the width]


class MeshReport(NamedTuple):
    """What a mesh file is, and what a scene does with it."""

    read: ReadMesh
    size: tuple[float, float, float]  # in the file's unit
    units: list[UnitCandidate]
    scale: float  # at which it was examined [m per unit]
    repaired: Repaired
    holes: list[Hole]  # widths in the file's unit
    # probed places of its faces where the mesh crosses or overlaps itself
    crossings: int
    probes: int
    verdict: str  # empty if it is felt as a solid, else why it is not
    sheet: str  # the same with sides: both


def examine(path: Path, where: str, scale: float | None = None) -> MeshReport:
    """Return what a mesh file is.

    Parameters
    ----------
    path : Path
        The file.
    where : str
        Place of its name, for errors.
    scale : float, optional
        Scale of the scene [m per unit]; by default that of the first likely unit.

    Raises
    ------
    ParameterError
        If the file cannot be read or no triangle has an area.
    """
    read = read_mesh(path, where)
    if not np.isfinite(read.corners).all():
        raise ParameterError(
            f"{path}: a coordinate is not finite; export the mesh again", path=where
        )
    with np.errstate(over="ignore"):
        size = np.ptp(read.corners.reshape(-1, 3), axis=0)
    width = float(size.max())
    if not width < _WIDEST:
        raise ParameterError(
            f"{path}: is {width:.3g} units wide; export the mesh again", path=where
        )
    units = unit_candidates(width)
    if scale is None:
        likely = [one.scale for one in units if one.is_likely] or [
            one.scale for one in units
        ]
        scale = likely[0] if likely else _WIDTH / max(width, 1e-300)
    try:
        repaired = repair(read.corners, height=SLIVER / scale, narrow=NARROW / scale)
    except ValueError as error:
        raise ParameterError(f"{path}: {error}", path=where) from error
    if not len(repaired.ids):
        raise ParameterError(
            f"{path}: no triangle has an area; export its surface", path=where
        )
    crossings, probes = (
        count_crossings(repaired, width) if repaired.is_solid else (0, 0)
    )
    x, y, z = size.tolist()
    return MeshReport(
        read,
        (x, y, z),
        units,
        scale,
        repaired,
        holes(repaired.points, repaired.ids, rims(repaired.partner)),
        crossings,
        probes,
        *_refusals(read.corners * scale),
    )


def count_crossings(found: Repaired, width: float) -> tuple[int, int]:
    """Return at how many places of its faces a solid crosses itself, of how many probed.

    Next to a face of a solid the winding number is 1 on its inner and 0 on its outer side.
    """
    corners = found.points[found.ids]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    twice_area = np.linalg.norm(across, axis=1)
    rng = np.random.default_rng(0)
    count = int(np.clip(_WORK // len(corners), *_PROBES))
    chosen = rng.choice(len(corners), count, p=twice_area / twice_area.sum())
    parts = rng.dirichlet((1.0, 1.0, 1.0), count)
    places = np.einsum("ij,ijk->ik", parts, corners[chosen])
    step = _OFF_FACE * width * across[chosen] / twice_area[chosen][:, None]
    outer = np.rint(winding_number(corners, places + step))
    inner = np.rint(winding_number(corners, places - step))
    return int(((outer != 0.0) | (inner != 1.0)).sum()), count


def refusal_of(found: Repaired, scale: float) -> str:
    """Return why a repaired mesh in its file's unit is felt as no solid; empty if it is."""
    try:
        refuse_no_solid(found._replace(points=found.points * scale), "", ())
    except ParameterError as error:
        return error.text
    return ""


def _refusals(corners: Coordinates) -> tuple[str, str]:
    """Return why triangles [m] are felt as no solid, and as no sheet; empty if they are."""
    try:
        found = repaired_triangles(corners, "")
    except ParameterError as error:
        return error.text, error.text
    return refusal_of(found, 1.0), ""


def single_precision_error(points: Coordinates) -> float:
    """Return the largest distance along an axis by which single precision moves corners."""
    return float(np.abs(points.astype(np.float32) - points).max())


def write_mesh(path: Path, points: Coordinates, ids: Ids) -> None:
    """Write triangles as OBJ, or as binary STL, which has single precision only."""
    if path.suffix.lower() == ".obj":
        lines = [f"v {x!r} {y!r} {z!r}\n" for x, y, z in points.tolist()]
        lines += [f"f {a} {b} {c}\n" for a, b, c in (ids + 1).tolist()]
        path.write_text("".join(lines), encoding="ascii")
        return
    records = np.zeros(
        len(ids),
        dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")],
    )
    records["corners"] = points[ids]
    header = b"haptic mesh --close".ljust(80) + struct.pack("<I", len(ids))
    path.write_bytes(header + records.tobytes())
