"""Triangles from STL (binary or text), OBJ, PLY and OFF files; 3MF and glTF beside."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from nodes.parameters.store import ParameterError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from nodes.environment.shapes.polygons import Faces

# largest file [bytes], about five million triangles; checked before reading
LARGEST: Final = 256_000_000
MOST_EDGES: Final = 40  # of a hole that is filled on request
MOST_WIDTH: Final = 0.1  # of such a hole [of the mesh's width]

_HEADER: Final = 84
_RECORD: Final = 50
_MARKS: Final = (
    (b"\xef\xbb\xbf", "utf-8"),
    (b"\xff\xfe\x00\x00", "utf-32"),
    (b"\x00\x00\xfe\xff", "utf-32"),
    (b"\xff\xfe", "utf-16"),
    (b"\xfe\xff", "utf-16"),
)


class ReadMesh(NamedTuple):
    """Triangles of a file, and what was read otherwise than it stands there."""

    corners: NDArray[np.float64]  # in the file's unit, shape (n, 3, 3)
    notes: tuple[str, ...]
    faces: dict[int, int]  # number of faces by their number of corners
    unit: str = ""  # that the file names; most formats name none


def read_triangles(path: Path, where: str) -> NDArray[np.float64]:
    """Return the corners of a file's triangles, in its unit, shape (n, 3, 3).

    Raises ParameterError if the file cannot be read or has no triangles.
    """
    return read_mesh(path, where).corners


def read_mesh(path: Path, where: str) -> ReadMesh:
    """Return a file's triangles in its unit, and notes about how they were read.

    Raises ParameterError if the file cannot be read or has no triangles.
    """
    import numpy as np

    from nodes.environment.shapes.mesh_library import KINDS, read_by_library
    from nodes.environment.shapes.polygons import cut_faces

    readers = _readers()
    kind = path.suffix.lower()
    if kind not in (*readers, *KINDS):
        raise ParameterError(
            f"{path} is neither an .stl, .obj, .ply nor .off file, nor .3mf, .glb or .gltf; export"
            " the mesh as one of these",
            path=where,
        )
    try:
        size = path.stat().st_size
        if not path.is_file():
            raise ParameterError(f"{path} is not a file", path=where)
        if size > LARGEST:
            raise ParameterError(
                f"{path} has {size / 1e6:.0f} MB, more than {LARGEST / 1e6:.0f}; decimate the mesh",
                path=where,
            )
        data = path.read_bytes()
    except OSError as error:
        raise ParameterError(
            f"{path} cannot be read: {error.strerror}", path=where
        ) from error
    try:
        if not data:
            raise ValueError("is empty (0 bytes); export the mesh again")
        if kind in readers:
            (points, groups, notes) = readers[kind](data)
            unit = ""
        else:
            (points, groups, notes), unit = read_by_library(
                data, kind, f"{where}: {path}", LARGEST
            )
        if not sum(map(len, groups.values())):
            raise ValueError(
                f"has no triangles ({len(points)} points); export its surface"
            )
        # coordinates that are not finite are refused later
        with np.errstate(all="ignore"):
            ids, cut, crossed = cut_faces(points, groups)
    except (ValueError, IndexError, OverflowError) as error:
        raise ParameterError(f"{path}: {error}", path=where) from error
    more = []
    if cut:
        more.append(f"{cut} faces that are not convex cut into triangles")
    if crossed:
        more.append(f"{crossed} faces cross themselves")
    return ReadMesh(
        points[ids],
        (*notes, *more),
        {k: len(faces) for k, faces in sorted(groups.items())},
        unit,
    )


def _readers() -> dict[str, Callable[[bytes], Faces]]:
    from nodes.environment.shapes.mesh_formats import read_off, read_ply

    return {
        ".stl": _stl,
        ".obj": _obj,
        ".ply": read_ply,
        ".off": lambda data: read_off(text_of(data)),
    }


def text_of(data: bytes) -> str:
    """Return text in UTF-8, or in UTF-16 or UTF-32, without its byte order mark."""
    for mark, code in _MARKS:
        if data.startswith(mark):
            return data.decode(code, errors="replace").lstrip("\ufeff")
    head = data[:200]
    for first, code in ((1, "utf-16-le"), (0, "utf-16-be")):
        half = head[first::2]
        if (
            len(head) > 8
            and half.count(0) > 0.8 * len(half)
            and 0 not in head[1 - first :: 2]
        ):
            return data.decode(code, errors="replace")
    return data.decode("utf-8", errors="replace")


def _stl(data: bytes) -> Faces:
    import numpy as np

    from nodes.environment.shapes.polygons import Faces

    count = int.from_bytes(data[80:_HEADER], "little") if len(data) >= _HEADER else 0
    whole = _HEADER + _RECORD * count
    # A binary file may also begin with "solid"; its length distinguishes it.
    if count == 0 or len(data) != whole:
        text = (
            text_of(data) if data.startswith(tuple(mark for mark, _ in _MARKS)) else ""
        )
        if text or _is_text_stl(data):
            return _text_stl(text or text_of(data))
        if len(data) < whole or len(data) < _HEADER:
            raise ValueError(
                f"is no STL file, or is cut off: {len(data)} bytes, where {count} triangles take"
                f" {whole}"
            )
        if count == 0:
            raise ValueError(
                "has no triangles: its header says 0; export the mesh again"
            )
    records = np.frombuffer(
        data,
        dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")],
        count=count,
        offset=_HEADER,
    )
    points = records["corners"].astype(np.float64).reshape(-1, 3)
    extra = len(data) - whole
    notes = (f"{extra} bytes after the last triangle left out",) if extra else ()
    return Faces(points, {3: np.arange(len(points)).reshape(-1, 3)}, notes)


def _is_text_stl(data: bytes) -> bool:
    """Whether a file that begins with "solid" has text, not only a header."""
    if data.lstrip()[:5].lower() != b"solid":
        return False
    return b"\x00" not in data[:4096] or b"facet" in data[:4096].lower()


def _text_stl(text: str) -> Faces:
    import numpy as np

    from nodes.environment.shapes.polygons import Faces

    numbers, complete, line = [], True, 0
    for line, row in enumerate(text.splitlines(), 1):
        words = row.split()
        word = words[0].lower() if words else ""
        if word == "vertex":
            numbers.append(_numbers(words[1:4], line))
            complete = False
        elif word == "endfacet":
            complete = True
    if len(numbers) % 3 or not complete:
        raise ValueError(f"is cut off: {len(numbers)} corners in {line} lines")
    notes = (
        ()
        if "endsolid" in text.lower()
        else ("no endsolid at the end: the file may be cut off",)
    )
    points = np.array(numbers, dtype=np.float64).reshape(-1, 3)
    return Faces(points, {3: np.arange(len(points)).reshape(-1, 3)}, notes)


def _obj(data: bytes) -> Faces:
    import numpy as np

    from nodes.environment.shapes.polygons import Faces, group_by_corners

    points: list[list[float]] = []
    faces: list[list[int]] = []
    largest, at = 0, (0, 0)  # largest number of a corner, in which line
    lines = continued = 0
    for line, row in _lines(text_of(data)):
        words = row.split("#", 1)[0].split()
        continued += row.count("\n")
        if words and words[0] == "v":
            points.append(_numbers(words[1:4], line))
        elif words and words[0] in ("f", "fo"):
            face = [_corner(word, len(points), line) for word in words[1:]]
            if max(face, default=0) > largest:
                largest = max(face)
                at = (line, largest + 1)
            if len(face) < 3:
                lines += 1
            else:
                faces.append(face)
    if largest >= max(len(points), 1):
        raise ValueError(
            f"line {at[0]}: corner {at[1]}, but the file has {len(points)}"
        )
    notes = []
    if lines:
        notes.append(f"{lines} faces of fewer than three corners left out")
    if continued:
        notes.append(f"{continued} lines continued by a backslash")
    return Faces(
        np.array(points, dtype=np.float64).reshape(-1, 3),
        group_by_corners(faces),
        tuple(notes),
    )


def _lines(text: str) -> Iterator[tuple[int, str]]:
    """Yield number and text of each line, joined with those that a backslash continues."""
    parts: list[str] = []
    first = 0
    for line, row in enumerate(text.splitlines(), 1):
        if not parts:
            first = line
        if row.rstrip().endswith("\\") and not (parts or [row])[0].lstrip().startswith(
            "#"
        ):
            parts.append(row.rstrip()[:-1] + "\n")
        else:
            yield first, "".join([*parts, row])
            parts = []
    if parts:
        yield first, "".join(parts)


def _numbers(words: list[str], line: int) -> list[float]:
    try:
        numbers = [float(word) for word in words]
    except ValueError as error:
        comma = (
            "; write decimals with a point"
            if re.search(r"\d,\d", " ".join(words))
            else ""
        )
        raise ValueError(f"line {line}: {error}{comma}") from error
    if len(numbers) != 3:
        raise ValueError(f"line {line}: {len(numbers)} coordinates, expected 3")
    return numbers


def _corner(word: str, known: int, line: int) -> int:
    """Return the number of a corner from 0; a negative one counts back from the last."""
    try:
        number = int(word.partition("/")[0])
    except ValueError as error:
        raise ValueError(f"line {line}: {word[:40]!r} names no corner") from error
    if number == 0 or -number > known:
        raise ValueError(f"line {line}: corner {number}, but {known} are known so far")
    return number - 1 if number > 0 else known + number
