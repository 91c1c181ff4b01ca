"""Read a table of another program (CSV, NPZ, MAT, Parquet) as columns of numbers by name.

An array of three columns becomes three columns, ``NAME_x``, ``NAME_y`` and ``NAME_z``, so that
every format is chosen from in the same way. Nothing is converted here.
"""

from __future__ import annotations

import csv
import functools
import io
import re
import zipfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nodes.parameters.nearest import did_you_mean
from nodes.recording.mat_file import read_mat
from nodes.recording.mcap_walk import TABLES, TEXT_TABLES
from nodes.recording.writer import RecordError

if TYPE_CHECKING:
    import numpy as np

    Column = np.ndarray[Any, Any]

LARGEST = 1 << 30  # largest file, unpacked, that is read [bytes]
_TICKS = "ticks"  # table of our own exports with one row per tick
_COMMA = re.compile(r"[+-]?\d+,\d+(?:[eE][+-]?\d+)?")
_HEADER_UNIT = re.compile(r"^(?P<name>.*?)\s*[\[(](?P<unit>[^\])]*)[\])]$")


@dataclass(frozen=True)
class ForeignTable:
    """Columns of a file, all of one axis.

    Attributes
    ----------
    path : Path
        The file.
    columns : dict of str to numpy.ndarray
        Columns by their names without units; numbers, or texts where a file has texts.
    units : dict of str to str
        Units that the file itself names.
    line : int
        Line of the first row in a text file; 0 in other formats, whose rows count from 0.
    rate : float or None
        Rate of its ticks, if the file names it [Hz].
    """

    path: Path
    columns: dict[str, Column]
    units: dict[str, str] = field(default_factory=dict)
    line: int = 0
    rate: float | None = None

    def place(self, row: int) -> str:
        """Return where a row is in the file, for a person."""
        return f"line {row + self.line}" if self.line else f"row {row}"

    def numbers(self, name: str) -> Column:
        """Return a column as numbers; an empty field is NaN.

        Parameters
        ----------
        name : str
            Name of the column.

        Returns
        -------
        numpy.ndarray
            Shape (N,); integers stay integers, so that stamps in nanoseconds stay exact.

        Raises
        ------
        RecordError
            If there is no such column, or a field is no number.
        """
        import numpy as np

        if name not in self.columns:
            hint = did_you_mean(name, self.columns)
            raise RecordError(
                f"{self.path}: no column {name!r}{hint}; there are {', '.join(self.columns)}"
            )
        column = self.columns[name]
        if column.dtype.kind in "iuf":
            return column
        if column.dtype.kind == "b":
            return column.astype(np.float64)
        values = [str(value).strip() for value in column]
        try:
            return np.array([int(value) for value in values], dtype=np.int64)
        except (ValueError, OverflowError):
            pass
        found = np.empty(len(values))
        for row, value in enumerate(values):
            try:
                found[row] = float(value) if value else np.nan
            except ValueError:
                raise RecordError(
                    f"{self.path}: {self.place(row)}, column {name!r}: {value[:40]!r} is no number"
                ) from None
        return found


def read_foreign(path: Path, *, decimal_comma: bool = False) -> ForeignTable:
    """Read a table: CSV, NPZ, MAT or Parquet, or the directory of a CSV export.

    Parameters
    ----------
    path : Path
        The file; its suffix names the format.
    decimal_comma : bool
        Whether a text file writes 0,5 for 0.5.

    Returns
    -------
    ForeignTable
        Its columns.

    Raises
    ------
    RecordError
        If the file cannot be read as a table; the text names the place and the remedy.
    """
    if is_export(path):
        path = path / f"{_TICKS}.csv"
    suffix = path.suffix.lower()
    if suffix == ".mcap":
        raise RecordError(
            f"{path}: is an MCAP file already; open it with: haptic bag info {path}"
        )
    if suffix in TEXT_TABLES:
        reader: Callable[[Path], ForeignTable] = functools.partial(
            _read_text, decimal_comma=decimal_comma
        )
    elif suffix in _READERS:
        reader = _READERS[suffix]
    elif path.is_dir():
        raise RecordError(
            f"{path}: is a folder without metadata.yaml, so it is no ROS bag"
        )
    else:
        known = ", ".join(TABLES)
        raise RecordError(
            f"{path}: the suffix {suffix!r} is no table read here; read are {known}"
        )
    try:
        if path.stat().st_size > LARGEST:
            raise RecordError(
                f"{path}: larger than {LARGEST >> 20} MiB; import it in parts"
            )
        found = reader(path)
    except RecordError:
        raise
    except OSError as error:
        raise RecordError(f"{path}: {error.strerror or error}") from error
    # The libraries of these formats raise many kinds for a damaged file.
    except Exception as error:
        raise RecordError(
            f"{path}: cannot be read as {suffix[1:].upper()}: {error}"
        ) from error
    if not found.columns or not max(len(column) for column in found.columns.values()):
        raise RecordError(f"{path}: no column with a row")
    return found


def is_export(folder: Path) -> bool:
    """Whether a path is the directory of a CSV export."""
    return (folder / f"{_TICKS}.csv").is_file()


def _decoded(path: Path) -> str:
    data = path.read_bytes()
    codes = (
        ("utf-16",)
        if data[:2] in (b"\xff\xfe", b"\xfe\xff")
        else ("utf-8-sig", "cp1252")
    )
    for code in codes:
        try:
            text = data.decode(code)
        except UnicodeDecodeError:
            continue
        if "\0" not in text:
            return text
    raise RecordError(
        f"{path}: is no text; name it by its format (.npz, .mat, .parquet)"
    )


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _delimiter(lines: list[str]) -> str | None:
    """Return the delimiter of most fields in the first line; None for white space."""
    first = lines[0]
    for delimiter in ("\t", ";", ","):
        if delimiter in first:
            return delimiter
    return None


def _read_text(path: Path, decimal_comma: bool) -> ForeignTable:
    import numpy as np

    lines = _decoded(path).splitlines()
    skipped = 0
    while skipped < len(lines) and (
        not lines[skipped].strip() or lines[skipped].startswith(("#", "%"))
    ):
        skipped += 1
    lines = lines[skipped:]
    while lines and not lines[-1].strip():
        lines.pop()
    if not lines:
        raise RecordError(f"{path}: is empty")
    delimiter = _delimiter(lines)
    try:
        if delimiter is None:
            fields = [line.split() for line in lines]
        else:
            stream = io.StringIO("\n".join(lines))
            fields = list(
                csv.reader(stream, delimiter=delimiter, skipinitialspace=True)
            )
    except csv.Error as error:
        raise RecordError(f"{path}: is no CSV: {error}") from error
    header = [name.strip() for name in fields[0]]
    first = skipped + 2
    if all(map(_is_number, header)) or (
        decimal_comma and all(map(_COMMA.fullmatch, header))
    ):
        header = [str(number + 1) for number in range(len(header))]
        first = skipped + 1
    else:
        fields = fields[1:]
    if (
        header
        and not header[-1]
        and all(len(row) < len(header) or not row[-1] for row in fields)
    ):
        header = header[:-1]  # a delimiter at the end of each line
        fields = [row[: len(header)] for row in fields]
    _refuse_ragged(path, header, fields, first, delimiter)
    if delimiter != ",":
        fields = _with_points(path, fields, first, decimal_comma)
    names, units = _names_of(header)
    rows = np.array(fields, dtype=object).reshape(-1, len(names))
    return ForeignTable(
        path, {name: rows[:, place] for place, name in enumerate(names)}, units, first
    )


def _refuse_ragged(
    path: Path,
    header: list[str],
    fields: list[list[str]],
    first: int,
    delimiter: str | None,
) -> None:
    for number, row in enumerate(fields):
        if len(row) == len(header):
            continue
        hint = ""
        if delimiter == "," and len(row) > len(header):
            hint = (
                "; if its numbers have decimal commas, write it with semicolons between the"
                " fields, and import it with --decimal-comma"
            )
        raise RecordError(
            f"{path}: line {first + number} has {len(row)} fields, the first line"
            f" {len(header)}{hint}"
        )


def _with_points(
    path: Path, fields: list[list[str]], first: int, decimal_comma: bool
) -> list[list[str]]:
    """Return the fields with decimal points; refuse decimal commas that were not asked for."""
    if decimal_comma:
        return [
            [
                text.replace(",", ".") if _COMMA.fullmatch(text.strip()) else text
                for text in row
            ]
            for row in fields
        ]
    for number, row in enumerate(fields):
        for text in row:
            if _COMMA.fullmatch(text.strip()):
                raise RecordError(
                    f"{path}: line {first + number}: {text.strip()!r} has a decimal comma; read"
                    " it as a number with --decimal-comma"
                )
    return fields


def _names_of(header: Sequence[str]) -> tuple[list[str], dict[str, str]]:
    """Return the names of columns without units, made unique, and the units."""
    split = [_HEADER_UNIT.match(text) for text in header]
    plain = [
        (found["name"] if found else text) or str(place + 1)
        for place, (text, found) in enumerate(zip(header, split, strict=True))
    ]
    names = [
        name if plain.count(name) == 1 else f"{name} (column {place + 1})"
        for place, name in enumerate(plain)
    ]
    units = {
        name: found["unit"].strip()
        for name, found in zip(names, split, strict=True)
        if found and found["unit"].strip()
    }
    return names, units


def _from_arrays(path: Path, arrays: Mapping[str, Any]) -> ForeignTable:
    """Return the columns of named arrays; arrays of three columns become three columns."""
    import numpy as np

    own = {
        name: value for name, value in arrays.items() if name.startswith(f"{_TICKS}.")
    }
    columns: dict[str, Column] = {}
    units: dict[str, str] = {}
    for full, value in (own or arrays).items():
        (name,), unit = _names_of([full.removeprefix(f"{_TICKS}.") if own else full])
        array = np.squeeze(np.asarray(value))
        units |= unit
        if array.ndim == 2 and 3 in array.shape:
            for part, column in zip(
                "xyz", array.T if array.shape[1] == 3 else array, strict=True
            ):
                columns[f"{name}_{part}"] = column
                units |= {f"{name}_{part}": unit[name]} if unit else {}
        elif array.ndim == 1 and array.dtype.kind in "biufUO":
            columns[name] = array
    return ForeignTable(path, columns, units)


def _read_npz(path: Path) -> ForeignTable:
    import numpy as np

    try:
        with zipfile.ZipFile(path) as archive:
            if sum(entry.file_size for entry in archive.infolist()) > LARGEST:
                raise RecordError(
                    f"{path}: unpacks to more than {LARGEST >> 20} MiB; import it in parts"
                )
        with np.load(path, allow_pickle=False) as arrays:
            return _from_arrays(path, dict(arrays))
    except (ValueError, zipfile.BadZipFile, EOFError, KeyError) as error:
        raise RecordError(f"{path}: is no NPZ of plain arrays: {error}") from error


def _read_mat(path: Path) -> ForeignTable:
    return _from_arrays(path, dict(_flattened(read_mat(path))))


def _flattened(found: Mapping[str, Any], before: str = "") -> Iterable[tuple[str, Any]]:
    """Yield the arrays of nested structures, named with dots."""
    for name, value in found.items():
        if isinstance(value, dict):
            yield from _flattened(value, f"{before}{name}.")
        elif not name.startswith("__") and not isinstance(value, str):
            yield f"{before}{name}", value


def _read_parquet(path: Path) -> ForeignTable:
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError as error:
        raise RecordError(
            f"{path}: Parquet needs pyarrow: pip install 'haptic-nodes[parquet]', or write CSV"
        ) from error
    try:
        table = parquet.read_table(path)
        arrays: dict[str, Any] = {}
        units: dict[str, str] = {}
        for column, array in zip(table.schema, table.columns, strict=True):
            arrays[column.name] = array.to_numpy()
            unit = (column.metadata or {}).get(b"unit", b"").decode("utf-8", "replace")
            units |= {column.name: unit} if unit else {}
    except (pa.ArrowException, OSError) as error:
        raise RecordError(f"{path}: cannot be read as Parquet: {error}") from error
    found = _from_arrays(path, arrays)
    return ForeignTable(path, found.columns, {**found.units, **units})


_READERS: dict[str, Callable[[Path], ForeignTable]] = {
    ".npz": _read_npz,
    ".mat": _read_mat,
    ".parquet": _read_parquet,
}
