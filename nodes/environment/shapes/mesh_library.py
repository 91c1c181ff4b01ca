"""3MF and glTF by trimesh, where it is installed; bounded before it reads anything."""

from __future__ import annotations

import io
import zipfile
from typing import Any, Final

import numpy as np

from nodes.environment.shapes.polygons import Faces
from nodes.parameters.store import ParameterError

KINDS: Final = (".3mf", ".glb", ".gltf")
EXTRA: Final = "pip install 'haptic-nodes[meshes]'"
_UNITS: Final = {  # of a 3MF file, as a scene names them
    "micron": "µm",
    "millimeter": "mm",
    "millimeters": "mm",
    "centimeter": "cm",
    "centimeters": "cm",
    "inch": "inch",
    "inches": "inch",
    "foot": "foot",
    "feet": "foot",
    "meter": "m",
    "meters": "m",
}


def read_by_library(
    data: bytes, kind: str, where: str, largest: int
) -> tuple[Faces, str]:
    """Return points, faces and notes of a file, and the unit that it names; empty for none.

    Parameters
    ----------
    data : bytes
        The file.
    kind : str
        One of `KINDS`.
    where : str
        Parameter path and file, for errors.
    largest : int
        Largest size of what is read, unpacked [bytes].

    Raises
    ------
    ParameterError
        If the library is missing.
    ValueError
        If the file cannot be read.
    """
    try:
        import trimesh
    except ImportError as error:
        raise ParameterError(
            f"{kind} needs a library ({error}): {EXTRA}, or export the mesh as .stl, .obj,"
            " .ply or .off",
            path=where,
        ) from error
    if kind == ".3mf":
        _check_size(data, largest)
    try:
        # From memory: a glTF file must not name others to be read.
        found: Any = trimesh.load_scene(io.BytesIO(data), file_type=kind[1:])
        whole = found.to_mesh()
        corners = np.asarray(whole.triangles, dtype=np.float64)
        unit = str(found.units or "")
    except ImportError as error:
        raise ParameterError(
            f"{kind} needs a library ({error}): {EXTRA}", path=where
        ) from error
    except Exception as error:  # a library may raise anything on a damaged file
        raise ValueError(
            f"cannot be read by trimesh {trimesh.__version__} ({type(error).__name__}:"
            f" {' '.join(str(error).split())[:200]}); a .gltf with files beside it is read as .glb"
        ) from error
    ids = np.arange(3 * len(corners), dtype=np.int64).reshape(-1, 3)
    unit = "m" if kind != ".3mf" else _UNITS.get(unit, "")
    return Faces(corners.reshape(-1, 3), {3: ids}, ()), unit


def _check_size(data: bytes, largest: int) -> None:
    """Raise ValueError if an archive unpacks to more than `largest` bytes, or is none."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            size = sum(one.file_size for one in archive.infolist())
    except (zipfile.BadZipFile, NotImplementedError) as error:
        raise ValueError(
            f"is no 3MF archive ({error}); export the mesh again"
        ) from error
    if size > largest:
        raise ValueError(
            f"unpacks to {size / 1e6:.0f} MB, more than {largest / 1e6:.0f}; decimate the mesh"
        )
