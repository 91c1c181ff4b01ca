"""Read the arrays of a MAT file (version 4 or 5) with every length checked.

scipy's reader takes lengths from the file without a check: a damaged file ends the process.
Layout: MathWorks, "MAT-File Format".
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nodes.recording.writer import RecordError

if TYPE_CHECKING:
    import numpy as np

    Values = np.ndarray[Any, Any]

LARGEST = 1 << 30  # largest size that one variable may unpack to [bytes]
DEEPEST = 16  # levels of structures and cells
_HEADER = 128  # bytes before the first element of version 5
_TYPES = {  # element types with numbers: code to numpy's type
    1: "i1",
    2: "u1",
    3: "i2",
    4: "u2",
    5: "i4",
    6: "u4",
    7: "f4",
    9: "f8",
    12: "i8",
    13: "u8",
}
_TEXTS = {
    4: "utf-16",
    16: "utf-8",
    17: "utf-16",
    18: "utf-32",
}  # element types with texts
_MATRIX, _COMPRESSED = 14, 15
_CELL, _STRUCT, _CHAR = 1, 2, 4
_NUMERIC = range(6, 16)  # classes double to uint64
_COMPLEX = 0x08  # flag of an array with an imaginary part
_VERSION_4 = {0: "f8", 1: "f4", 2: "i4", 3: "i2", 4: "u2", 5: "u1"}


class _DamagedError(ValueError):
    """A length, type or nesting that cannot be."""


class _Reader:
    """Elements of a block of bytes, one after the other."""

    def __init__(self, data: bytes | memoryview, order: str) -> None:
        self._data = memoryview(data)
        self._order = order
        self._at = 0

    @property
    def ended(self) -> bool:
        """Whether nothing but padding is left."""
        return len(self._data) - self._at < 8

    def element(self) -> tuple[int, memoryview]:
        """Return type and content of the next element."""
        if self.ended:
            raise _DamagedError("it ends within an element")
        kind, size = struct.unpack_from(f"{self._order}II", self._data, self._at)
        if kind >> 16:
            # A short one: size and type in four bytes, up to four bytes of content.
            kind, size, start = kind & 0xFFFF, kind >> 16, self._at + 4
            if size > 4:
                raise _DamagedError(f"a short element of {size} bytes")
            self._at += 8
        else:
            start = self._at + 8
            # Compressed elements are not padded.
            padded = size if kind == _COMPRESSED else -(-size // 8) * 8
            if size > len(self._data) - start:
                left = len(self._data) - start
                raise _DamagedError(
                    f"an element of {size} bytes, while {left} are left"
                )
            self._at = start + padded
        return kind, self._data[start : start + size]

    def numbers(self) -> Values:
        """Return the next element as numbers."""
        import numpy as np

        kind, content = self.element()
        if kind not in _TYPES:
            raise _DamagedError(f"an element of type {kind} in place of numbers")
        form = np.dtype(f"{self._order}{_TYPES[kind]}")
        if len(content) % form.itemsize:
            raise _DamagedError(f"{len(content)} bytes are no whole numbers")
        return np.frombuffer(content, form)

    def text(self) -> str:
        """Return the next element as text."""
        return bytes(self.numbers().astype("u1")).decode("latin-1")


def read_mat(path: Path) -> dict[str, Any]:
    """Return the variables of a MAT file.

    Parameters
    ----------
    path : Path
        File of version 4 (MATLAB's ``-v4``), 5, 6 or 7.

    Returns
    -------
    dict of str to object
        Numeric arrays, shape as in MATLAB; texts; lists of cells; structures as mappings.
        Functions, objects and sparse arrays are left out.

    Raises
    ------
    RecordError
        If the file is damaged, or is of version 7.3.
    """
    data = path.read_bytes()
    if (
        data[:4] == b"\x89HDF"
        or data[124:128] in (b"\0\2IM", b"\2\0MI")
        or b"MATLAB 7.3" in data[:20]
    ):
        raise RecordError(
            f"{path}: is a MAT file of version 7.3 (HDF5); save it with -v7"
        )
    try:
        if len(data) > _HEADER and data[126:128] in (b"IM", b"MI"):
            return dict(_version_5(data, "<" if data[126:128] == b"IM" else ">"))
        return dict(_version_4(data))
    except (
        _DamagedError,
        struct.error,
        zlib.error,
        UnicodeDecodeError,
        RecursionError,
    ) as error:
        raise RecordError(f"{path}: is no sound MAT file: {error}") from error


def _version_5(data: bytes, order: str) -> Iterator[tuple[str, Any]]:
    reader = _Reader(memoryview(data)[_HEADER:], order)
    while not reader.ended:
        kind, content = reader.element()
        if kind == _COMPRESSED:
            unpacker = zlib.decompressobj()
            whole = unpacker.decompress(content, LARGEST)
            if unpacker.unconsumed_tail:
                raise _DamagedError(
                    f"a variable that unpacks to more than {LARGEST >> 20} MiB"
                )
            kind, content = _Reader(whole, order).element()
        if kind == _MATRIX:
            name, value = _matrix(content, order, 0)
            if value is not None:
                yield name, value


def _matrix(content: memoryview, order: str, depth: int) -> tuple[str, Any]:
    """Return name and value of an array; None for a class that is not read."""
    if depth > DEEPEST:
        raise _DamagedError(f"structures nested deeper than {DEEPEST}")
    if not len(content):
        return "", []
    reader = _Reader(content, order)
    flags = reader.numbers()
    if len(flags) < 2:
        raise _DamagedError("an array without its class")
    kind = int(flags[0]) & 0xFF
    if kind not in (_CELL, _STRUCT, _CHAR, *_NUMERIC):
        return "", None
    shape = [int(n) for n in reader.numbers()]
    count = math.prod(shape)
    if len(shape) < 2 or min(shape) < 0 or count > LARGEST:
        raise _DamagedError(f"an array of shape {shape[:8]}")
    name = reader.text()
    if kind == _CELL:
        return name, [
            _inner(reader, order, depth)[1] for _ in range(_counted(count, content))
        ]
    if kind == _STRUCT:
        return name, _structure(reader, order, depth, count, content)
    if kind == _CHAR:
        form, content = reader.element()
        code = _TEXTS.get(form, "latin-1")
        code += ("-le" if order == "<" else "-be") if code[-2:] in ("16", "32") else ""
        return name, bytes(content).decode(code)
    values = reader.numbers()
    if len(values) != count:
        raise _DamagedError(f"{len(values)} values for the shape {shape}")
    if int(flags[0]) >> 8 & _COMPLEX:
        raise _DamagedError(f"{name!r} is complex, which no column here is")
    return name, values.reshape(shape, order="F")


def _inner(reader: _Reader, order: str, depth: int) -> tuple[str, Any]:
    kind, content = reader.element()
    if kind != _MATRIX:
        raise _DamagedError(f"an element of type {kind} in place of an array")
    return _matrix(content, order, depth + 1)


def _counted(count: int, content: memoryview) -> int:
    """Return how many elements follow; each takes eight bytes at least."""
    if count > len(content) // 8:
        raise _DamagedError(f"{count} elements in {len(content)} bytes")
    return count


def _structure(
    reader: _Reader, order: str, depth: int, count: int, content: memoryview
) -> dict[str, Any] | None:
    """Return the fields of one structure; None for an array of them."""
    width = reader.numbers()
    names = reader.text()
    if len(width) != 1 or not 0 < width[0] <= len(names) + 1 or not len(names):
        raise _DamagedError("the names of a structure's fields")
    step = int(width[0])
    padded = [names[at : at + step] for at in range(0, len(names), step)]
    fields = [name.split("\0")[0] for name in padded]
    if count != 1:
        return None
    _counted(len(fields), content)
    found = {name: _inner(reader, order, depth)[1] for name in fields}
    return {name: value for name, value in found.items() if value is not None}


def _version_4(data: bytes) -> Iterator[tuple[str, Any]]:
    """Yield the full numeric matrices of a version 4 file."""
    import numpy as np

    at = 0
    while at < len(data):
        if len(data) - at < 20:
            raise _DamagedError("it ends within a header")
        order = "<" if struct.unpack_from("<I", data, at)[0] < 5000 else ">"
        kind, rows, columns, imaginary, length = struct.unpack_from(
            f"{order}5I", data, at
        )
        number = kind // 1000
        form = kind // 10 % 10
        layout = kind % 10
        if (
            number not in (0, 1)
            or form not in _VERSION_4
            or layout > 2
            or not 0 < length <= 4096
        ):
            raise _DamagedError("it begins as none does")
        size = np.dtype(_VERSION_4[form]).itemsize
        start = at + 20 + length
        count = rows * columns
        end = start + count * size * (2 if imaginary else 1)
        if end > len(data):
            raise _DamagedError(f"a matrix of {rows} by {columns}, which does not fit")
        name = data[at + 20 : start].split(b"\0")[0].decode("latin-1")
        if layout == 0 and not imaginary:
            values = np.frombuffer(
                data, np.dtype(f"{order}{_VERSION_4[form]}"), count, start
            )
            yield name, values.reshape((rows, columns), order="F")
        at = end
