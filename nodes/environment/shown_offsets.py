"""Offsets of moving shapes for pages: the scene table itself, in a mapped file.

The geometry works on the table where it stands, so showing it costs the loop nothing. A reader may
see the three numbers of an offset of two successive ticks, which no picture shows.
"""

from __future__ import annotations

import ctypes
from array import array
from pathlib import Path
from typing import cast

from messages.types import Vector
from nodes.base.shared_file import mapped
from nodes.environment.shapes.tables import ROW, ROWS, SHAPES, SHIFT, SPEED, Table


def offsets_file(run_dir: str | Path, node: str) -> Path:
    """Return the path of an environment's file."""
    return Path(run_dir) / f"{node}.shapes"


def shown_table(table: array[float], path: Path) -> array[float]:
    """Move a scene table into a new file, which pages map; return it from there."""
    new = path.with_name(f"{path.name}.new")
    view = memoryview(mapped(new, 8 * len(table), make=True)).cast("d")
    view[:] = memoryview(table)
    new.replace(path)  # a reader of the table before sees this one when it looks again
    # It is indexed, sliced and compared as an array is; its address is that of `address_of`.
    return cast("array[float]", view)


def address_of(table: array[float]) -> tuple[int, int]:
    """Return the address of a table and the number of its floats."""
    if isinstance(table, array):
        return table.buffer_info()
    view = cast("memoryview", table)
    return ctypes.addressof(ctypes.c_double.from_buffer(view)), len(view)


def offsets_of(table: Table) -> list[Vector]:
    """Return the offset of each shape of a scene table that moves [m]."""
    rows = range(ROWS, ROWS + ROW * int(table[SHAPES]), ROW)
    return [
        (table[row + SHIFT], table[row + SHIFT + 1], table[row + SHIFT + 2])
        for row in rows
        if table[row + SPEED] > 0.0
    ]


class ShownOffsets:
    """Reads the offsets of the shapes that move from an environment's file."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._inode = 0
        self._table: Table = ()

    def read(self) -> list[Vector] | None:
        """Return the offset of each shape that moves [m]; None without the file."""
        try:
            seen = self._path.stat()
        except FileNotFoundError:
            return None
        if seen.st_ino != self._inode:
            whole = mapped(self._path, seen.st_size, make=False)
            self._table = memoryview(whole).cast("d")
            self._inode = seen.st_ino
        return offsets_of(self._table)
