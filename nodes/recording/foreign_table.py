"""Read a table of another program (CSV, NPZ, NPY, MAT, Parquet) as columns by name.

An array of three columns becomes three columns, ``NAME_x``, ``NAME_y`` and ``NAME_z``, one of
several ``NAME_1`` and so on, so that every format is chosen from in the same way. Nothing is
converted here.
"""

from __future__ import annotations

import functools
import zipfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nodes.parameters.nearest import did_you_mean
from nodes.recording.foreign_clock import clock_times, is_clock, is_date
from nodes.recording.foreign_text import names_of, read_text
from nodes.recording.mat_file import read_mat
from nodes.recording.mcap_walk import TABLES, TEXT_TABLES
from nodes.recording.writer import RecordError

if TYPE_CHECKING:
    import numpy as np

    Column = np.ndarray[Any, Any]

LARGEST = 1 << 30  # largest file, unpacked, that is read [bytes]
# ways out of formats that other programs turn into a table
_WAYS = {
    ".tdms": "nptdms.TdmsFile(FILE).as_dataframe().to_csv(…) writes one",
    ".mf4": "asammdf.MDF(FILE).to_dataframe().to_csv(…) writes one",
    ".c3d": "ezc3d.c3d(FILE)['data']['points'] has its points, as an array [mm]",
    ".xlsx": "save the sheet as CSV",
    ".gz": "unpack it with gunzip",
    ".zip": "unpack it with unzip",
    ".json": "pandas.read_json(FILE).to_csv(…) writes one",
    ".feather": "pandas.read_feather(FILE).to_parquet(…) writes one",
    ".arrow": "pandas.read_feather(FILE).to_parquet(…) writes one",
    ".h5": "numpy.savez(…) of its arrays writes one",
    ".hdf5": "numpy.savez(…) of its arrays writes one",
}
_TICKS = "ticks"  # table of our own exports with one row per tick
_SHOWN = 20  # columns that an error names
_WIDEST = 64  # columns of an array that become columns of their own


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
    lines : sequence of int
        Line of each row in a text file; empty in other formats, whose rows count from 0.
    rate : float or None
        Rate of its ticks, if the file names it [Hz].
    rows : sequence of int
        Row of the file of each row, counted from 0; empty: all of them.
    """

    path: Path
    columns: dict[str, Column]
    units: dict[str, str] = field(default_factory=dict)
    lines: Sequence[int] = ()
    rate: float | None = None
    rows: Sequence[int] = ()

    def place(self, row: int) -> str:
        """Return where a row is in the file, for a person."""
        row = self.rows[row] if self.rows else row
        return f"line {self.lines[row]}" if self.lines else f"row {row}"

    def of_rows(self, kept: np.ndarray[Any, np.dtype[np.bool_]]) -> ForeignTable:
        """Return the table of some rows; columns of another length are left out."""
        columns = {
            name: column[kept]
            for name, column in self.columns.items()
            if len(column) == len(kept)
        }
        return replace(self, columns=columns, rows=kept.nonzero()[0].tolist())

    @property
    def names(self) -> str:
        """The names of its columns, of many the first, for a person."""
        more = len(self.columns) - _SHOWN
        first = ", ".join(list(self.columns)[:_SHOWN])
        return f"{first} and {more} more" if more > 0 else first

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
                f"{self.path}: no column {name!r}{hint}; there are {self.names}"
            )
        column = self.columns[name]
        if column.dtype.kind in "iuf":
            return column
        if column.dtype.kind == "b":
            return column.astype(np.float64)
        values = [str(value).strip() for value in column]
        try:
            # Python alone writes 1_000.
            if not any("_" in value for value in values):
                return np.array([int(value) for value in values], dtype=np.int64)
        except (ValueError, OverflowError):
            pass
        found = np.empty(len(values))
        for row, value in enumerate(values):
            try:
                found[row] = float(value.replace("_", "?")) if value else np.nan
            except ValueError:
                why = "is no number"
                if is_date(value):
                    why = "is a date without a time of the day"
                elif is_clock(value):
                    why = "is a time, but other rows are empty or have another form"
                raise RecordError(
                    f"{self.path}: {self.place(row)}, column {name!r}: {value[:40]!r} {why}"
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
            f"{path}: is no table and no ROS bag; open it with: haptic bag info {path}"
        )
    if suffix in TEXT_TABLES:
        reader: Callable[[Path], ForeignTable] = functools.partial(
            _read_text, decimal_comma=decimal_comma
        )
    elif suffix in _READERS:
        reader = _READERS[suffix]
    elif path.is_dir():
        raise RecordError(
            f"{path}: is a folder without metadata.yaml, so it is no ROS bag; import one of its"
            " files, or write metadata.yaml with ros2 bag reindex FOLDER"
        )
    else:
        known = ", ".join(TABLES)
        way = f"; {_WAYS[suffix]}" if suffix in _WAYS else ""
        raise RecordError(
            f"{path}: the suffix {suffix!r} is no table read here; read are {known}{way}"
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
    return _with_clock(found)


def is_export(folder: Path) -> bool:
    """Whether a path is the directory of a CSV export."""
    return (folder / f"{_TICKS}.csv").is_file()


def _with_clock(table: ForeignTable) -> ForeignTable:
    """Return a table whose times of the clock are integers in nanoseconds."""
    import numpy as np

    read = {
        name: clock_times(map(str, column))
        for name, column in table.columns.items()
        if column.dtype.kind in "UO" and len(column)
    }
    times = {name: np.array(found) for name, found in read.items() if found is not None}
    times |= _with_dates(table, times)
    units = dict.fromkeys(times, "ns")
    return replace(table, columns=table.columns | times, units={**table.units, **units})


def _with_dates(table: ForeignTable, times: Iterable[str]) -> dict[str, Column]:
    """Return times of the day with the date that the only other column of dates has.

    Only where that date changes: without it, days between two rows would be lost.
    """
    import numpy as np

    dates = [
        [str(date).strip() for date in column]
        for name, column in table.columns.items()
        if name not in times and column.dtype.kind in "UO" and len(column)
    ]
    dates = [column for column in dates if all(map(is_date, column))]
    if len(dates) != 1 or len(set(dates[0])) == 1:
        return {}
    found = {}
    for name in times:
        texts = [str(time).strip() for time in table.columns[name]]
        if len(texts) == len(dates[0]):
            # A time that has a date has no place for another.
            joined = map(" ".join, zip(dates[0], texts, strict=True))
            if (stamps := clock_times(joined)) is not None:
                found[name] = np.array(stamps)
    return found


def _read_text(path: Path, decimal_comma: bool) -> ForeignTable:
    return ForeignTable(path, *read_text(path, decimal_comma))


def _from_arrays(path: Path, arrays: Mapping[str, Any]) -> ForeignTable:
    """Return the columns of named arrays; an array of several columns becomes several."""
    import numpy as np

    own = {
        name: value for name, value in arrays.items() if name.startswith(f"{_TICKS}.")
    }
    columns: dict[str, Column] = {}
    units: dict[str, str] = {}
    for full, value in (own or arrays).items():
        (name,), unit = names_of([full.removeprefix(f"{_TICKS}.") if own else full])
        array = np.squeeze(_of_numbers(np.asarray(value)))
        units |= unit
        if array.dtype.kind in "mM":
            array, units[name] = _nanoseconds(array), "ns"
        if array.dtype.names:
            columns |= {part: array[part] for part in array.dtype.names}
        elif array.ndim == 2 and min(array.shape) <= _WIDEST:
            for part, column in _parts(array):
                columns[f"{name}_{part}"] = column
                units |= {f"{name}_{part}": unit[name]} if unit else {}
        elif array.ndim == 1 and array.dtype.kind in "biufUO":
            columns[name] = array
    return ForeignTable(path, columns, units)


def _parts(array: Column) -> Iterable[tuple[str, Column]]:
    """Yield the columns of an array by axis, or by number if there are not three."""
    rows, wide = array.shape
    by_column = wide == 3 or (rows != 3 and wide <= rows)
    parts = array.T if by_column else array
    names = "xyz" if len(parts) == 3 else range(1, len(parts) + 1)
    for part, column in zip(names, parts, strict=True):
        yield str(part), column


def _of_numbers(array: Column) -> Column:
    """Return an array of lists, as Parquet has vectors, as an array of numbers."""
    import numpy as np

    if array.dtype.kind != "O" or not array.size:
        return array
    lists = all(isinstance(one, list | tuple | np.ndarray) for one in array.ravel())
    if not lists or len({len(one) for one in array.ravel()}) > 1:
        return array
    return np.array([list(one) for one in array.ravel()], dtype=np.float64)


def _nanoseconds(times: Column) -> Column:
    """Return times and durations in nanoseconds; missing ones are NaN."""
    import numpy as np

    missing = np.isnat(times)
    found = times.astype(f"{times.dtype.kind}8[ns]").astype(np.int64)
    return np.where(missing, np.nan, found) if missing.any() else found


def _read_npy(path: Path) -> ForeignTable:
    import numpy as np

    try:
        # As a map, whose size is checked before it is read.
        array = np.load(path, mmap_mode="r", allow_pickle=False)
        if not isinstance(array, np.ndarray):
            raise ValueError("it is an archive; name it .npz")
        if array.dtype.names or array.ndim != 2:
            return _from_arrays(path, {"1": array})
        columns = array if array.shape[0] < array.shape[1] else array.T
        return _from_arrays(path, {str(n): one for n, one in enumerate(columns, 1)})
    except (ValueError, EOFError) as error:
        raise RecordError(f"{path}: is no NPY of a plain array: {error}") from error


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
    ".npy": _read_npy,
    ".mat": _read_mat,
    ".parquet": _read_parquet,
}
