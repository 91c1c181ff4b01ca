"""Reading triangles from STL (binary or text) and OBJ files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

from nodes.parameters.store import ParameterError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

# largest file [bytes], about five million triangles; checked before reading
LARGEST: Final = 256_000_000

_HEADER: Final = 84
_RECORD: Final = 50


def read_triangles(path: Path, where: str) -> NDArray[np.float64]:
    """Return the corners of a file's triangles, in its unit, shape (n, 3, 3).

    Raises ParameterError if the file cannot be read or has no triangles.
    """
    kind = path.suffix.lower()
    if kind not in (".stl", ".obj"):
        raise ParameterError(f"{where}: {path} is neither an .stl nor an .obj file")
    try:
        size = path.stat().st_size
        if not path.is_file():
            raise ParameterError(f"{where}: {path} is not a file")
        if size > LARGEST:
            raise ParameterError(
                f"{where}: {path} has {size / 1e6:.0f} MB, more than {LARGEST / 1e6:.0f}; decimate"
                " the mesh"
            )
        data = path.read_bytes()
    except OSError as error:
        raise ParameterError(f"{where}: {path} cannot be read: {error.strerror}") from error
    try:
        found = _obj(data) if kind == ".obj" else _stl(data)
    except (ValueError, IndexError) as error:
        raise ParameterError(f"{where}: {path}: {error}") from error
    if not len(found):
        raise ParameterError(f"{where}: {path} has no triangles")
    return found


def _stl(data: bytes) -> NDArray[np.float64]:
    import numpy as np

    count = int.from_bytes(data[80:_HEADER], "little") if len(data) >= _HEADER else 0
    # A binary file may also begin with "solid"; its length distinguishes it.
    if count and len(data) == _HEADER + _RECORD * count:
        records = np.frombuffer(
            data,
            dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")],
            offset=_HEADER,
        )
        return records["corners"].astype(np.float64)
    if not data.lstrip()[:5].lower() == b"solid":
        raise ValueError(
            f"is no STL file, or is cut off: {len(data)} bytes, where {count} triangles take"
            f" {_HEADER + _RECORD * count}"
        )
    numbers = []
    for line, text in enumerate(data.decode("utf-8", errors="replace").splitlines(), 1):
        words = text.split()
        if words and words[0].lower() == "vertex":
            numbers.append(_numbers(words[1:4], line))
    if len(numbers) % 3 or b"endsolid" not in data.lower():
        raise ValueError(
            f"is cut off: {len(numbers)} corners"
            + (", and no endsolid" if len(numbers) % 3 == 0 else "")
        )
    return np.array(numbers, dtype=np.float64).reshape(-1, 3, 3)


def _obj(data: bytes) -> NDArray[np.float64]:
    import numpy as np

    points: list[list[float]] = []
    faces: list[list[list[float]]] = []
    for line, text in enumerate(data.decode("utf-8", errors="replace").splitlines(), 1):
        words = text.split()
        if words and words[0] == "v":
            points.append(_numbers(words[1:4], line))
        elif words and words[0] == "f":
            corners = [_corner(word, points, line) for word in words[1:]]
            if len(corners) < 3:
                raise ValueError(f"line {line}: a face of {len(corners)} corners")
            faces += [[corners[0], corners[i], corners[i + 1]] for i in range(1, len(corners) - 1)]
    return np.array(faces, dtype=np.float64).reshape(-1, 3, 3)


def _numbers(words: list[str], line: int) -> list[float]:
    try:
        numbers = [float(word) for word in words]
    except ValueError as error:
        raise ValueError(f"line {line}: {error}") from error
    if len(numbers) != 3:
        raise ValueError(f"line {line}: {len(numbers)} coordinates, expected 3")
    return numbers


def _corner(word: str, points: list[list[float]], line: int) -> list[float]:
    text = word.split("/")[0]
    try:
        number = int(text)
    except ValueError as error:
        raise ValueError(f"line {line}: {word!r} names no corner") from error
    if not 1 <= abs(number) <= len(points):
        raise ValueError(f"line {line}: corner {number}, but {len(points)} are known so far")
    return points[number - 1 if number > 0 else number]
