"""Readers of the mesh formats PLY (text or binary) and OFF."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any, Final, NamedTuple

import numpy as np

from nodes.environment.shapes.polygons import Faces, group_by_corners

_TYPES: Final = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}


class _Property(NamedTuple):
    name: str
    type: str
    counted_by: str  # type of a list's length; empty for a single value


class _Element(NamedTuple):
    name: str
    size: int
    properties: list[_Property]

    @property
    def corners(self) -> int:
        """Place of the list that holds a face's corners; −1 if none."""
        found = [
            i
            for i, one in enumerate(self.properties)
            if one.name.startswith("vertex_ind")
        ]
        return found[0] if found else -1


def read_ply(data: bytes) -> Faces:
    """Return the faces of a PLY file; raises ValueError if it has none or is cut off."""
    end = re.search(rb"end_header[ \t]*\r?\n", data)
    if not data.startswith(b"ply") or end is None:
        raise ValueError(
            "is no PLY file: its header does not begin with ply or does not end"
        )
    form, elements = _ply_header(data[: end.start()].decode("latin-1"))
    rows = _ascii_rows if form == "ascii" else _binary_rows
    points = np.zeros((0, 3))
    faces = []
    at = end.end()
    for element in elements:
        values, at = rows(data, at, element, ">" if "big" in form else "<")
        if element.name == "vertex":
            place = {one.name: i for i, one in enumerate(element.properties)}
            if not {"x", "y", "z"} <= place.keys():
                raise ValueError("has corners without x, y and z")
            points = np.array(
                [[row[place[k]] for k in "xyz"] for row in values], dtype=np.float64
            )
        elif element.name == "face" and element.corners >= 0:
            faces = [[int(n) for n in row[element.corners]] for row in values]
    return _checked(points, faces)


def _checked(points: Any, faces: list[list[int]]) -> Faces:
    for number, face in enumerate(faces):
        for corner in face:
            if not 0 <= corner < len(points):
                raise ValueError(
                    f"face {number} has corner {corner} (from 0), but the file has {len(points)}"
                )
    whole = [face for face in faces if len(face) >= 3]
    left = len(faces) - len(whole)
    notes = (f"{left} faces of fewer than three corners left out",) if left else ()
    return Faces(points.reshape(-1, 3), group_by_corners(whole), notes)


def _ply_header(text: str) -> tuple[str, list[_Element]]:
    form = ""
    elements = []
    for line, row in enumerate(text.splitlines(), 1):
        words = row.split()
        try:
            if words[:1] == ["format"]:
                form = words[1]
            elif words[:1] == ["element"]:
                elements.append(_Element(words[1], int(words[2]), []))
            elif words[:2] == ["property", "list"]:
                one = _Property(words[4], _TYPES[words[3]], _TYPES[words[2]])
                elements[-1].properties.append(one)
            elif words[:1] == ["property"]:
                elements[-1].properties.append(
                    _Property(words[2], _TYPES[words[1]], "")
                )
        except (IndexError, KeyError, ValueError) as error:
            raise ValueError(
                f"line {line}: {row.strip()[:60]!r} cannot be read"
            ) from error
    if form not in ("ascii", "binary_little_endian", "binary_big_endian"):
        raise ValueError(f"has the unknown PLY format {form!r}")
    return form, elements


def _ascii_rows(
    data: bytes, at: int, element: _Element, order: str
) -> tuple[list[Any], int]:
    del order
    found: list[Any] = []
    while len(found) < element.size:
        if at >= len(data):
            raise ValueError(
                f"is cut off: {len(found)} of {element.size} of {element.name}"
            )
        stop = data.find(b"\n", at)
        stop = len(data) if stop < 0 else stop
        words = data[at:stop].split()
        at = stop + 1
        if words:
            found.append(_ascii_row(words, element))
    return found, at


def _ascii_row(words: list[bytes], element: _Element) -> list[Any]:
    row: list[Any] = []
    k = 0
    for one in element.properties:
        if k >= len(words):
            raise ValueError(
                f"has a {element.name} without {one.name}, as its header says"
            )
        if one.counted_by:
            count = int(words[k])
            values = [float(word) for word in words[k + 1 : k + 1 + count]]
            if len(values) < count:
                raise ValueError(
                    f"has a {element.name} of {count} values that lists {len(values)}"
                )
            row.append(values)
            k += 1 + count
        else:
            row.append(float(words[k]))
            k += 1
    return row


def _binary_rows(
    data: bytes, at: int, element: _Element, order: str
) -> tuple[Any, int]:
    """Return the rows of an element; at once if all its lists are as long as the first."""
    if not element.size:
        return [], at
    short = ValueError(f"is cut off within {element.name}")
    try:
        first, _ = _binary_row(data, at, element, order)
        fields: list[Any] = []
        for i, one in enumerate(element.properties):
            if one.counted_by:
                fields.append((f"c{i}", order + one.counted_by))
                fields.append((f"v{i}", order + one.type, (len(first[i]),)))
            else:
                fields.append((f"v{i}", order + one.type))
        layout = np.dtype(fields)
        if len(data) >= at + layout.itemsize * element.size:
            rows = np.frombuffer(data, layout, element.size, at)
            if all(
                (rows[f"c{i}"] == len(first[i])).all()
                for i, one in enumerate(element.properties)
                if one.counted_by
            ):
                columns = [rows[f"v{i}"] for i in range(len(element.properties))]
                return list(
                    zip(*columns, strict=True)
                ), at + layout.itemsize * element.size
        found = []
        for _ in range(element.size):
            row, at = _binary_row(data, at, element, order)
            found.append(row)
    except ValueError as error:
        raise short from error
    return found, at


def _binary_row(
    data: bytes, at: int, element: _Element, order: str
) -> tuple[list[Any], int]:
    row: list[Any] = []
    for one in element.properties:
        count = 1
        if one.counted_by:
            count = int(np.frombuffer(data, order + one.counted_by, 1, at)[0])
            at += np.dtype(one.counted_by).itemsize
        values = (
            np.frombuffer(data, order + one.type, count, at) if count else np.zeros(0)
        )
        at += np.dtype(one.type).itemsize * count
        row.append(values if one.counted_by else values[0])
    return row, at


def read_off(text: str) -> Faces:
    """Return the faces of an OFF file; raises ValueError if it is none or is cut off."""
    rows = _off_rows(text)
    line, words = next(rows, (1, [""]))
    if not words[0].upper().endswith("OFF"):
        raise ValueError("is no OFF file: its first word is not OFF")
    if len(words) == 1:
        line, words = next(rows, (line, []))
    else:
        words = words[1:]
    try:
        sizes = int(words[0]), int(words[1])
    except (IndexError, ValueError) as error:
        raise ValueError(
            f"line {line}: numbers of corners and faces expected"
        ) from error
    points: list[list[float]] = []
    faces: list[list[int]] = []
    for line, words in rows:
        try:
            if len(points) < sizes[0]:
                x, y, z = words[:3]
                points.append([float(x), float(y), float(z)])
            elif len(faces) < sizes[1]:
                face = [int(word) for word in words[1 : 1 + int(words[0])]]
                if len(face) < int(words[0]):
                    raise ValueError(f"a face of {words[0]} corners lists {len(face)}")
                faces.append(face)
        except ValueError as error:
            raise ValueError(f"line {line}: {error}") from error
    if (len(points), len(faces)) != sizes:
        raise ValueError(
            f"is cut off: {len(points)} of {sizes[0]} corners, {len(faces)} of {sizes[1]} faces"
        )
    return _checked(np.array(points, dtype=np.float64), faces)


def _off_rows(text: str) -> Iterator[tuple[int, list[str]]]:
    for line, row in enumerate(text.splitlines(), 1):
        words = row.split("#", 1)[0].split()
        if words:
            yield line, words
