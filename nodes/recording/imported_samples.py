"""Choose position, force and time among the columns of a foreign table, in SI units.

Units are those of the file or of the caller; nothing is converted without one of them. Values that
make no sense in SI units are refused, with the unit that was probably meant.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from messages.errors import OTHER, Remedy
from nodes.recording.foreign_table import ForeignTable
from nodes.recording.foreign_units import UNITS
from nodes.recording.import_words import words
from nodes.recording.imported_columns import (
    checked_columns,
    checked_units,
    factor_in,
    is_own,
    time_column,
    vector_of,
)
from nodes.recording.imported_times import (
    RATE_TOLERANCE,
    growing,
    refuse_rate,
    refuse_unlikely_time,
    ticks_of,
    unit_hint,
)
from nodes.recording.writer import RecordError

if TYPE_CHECKING:
    import numpy as np

    Array = np.ndarray[Any, np.dtype[np.float64]]
    Kept = np.ndarray[Any, np.dtype[np.bool_]]

LARGEST_SPAN = 2.0  # span of positions beyond which another unit was probably meant [m]
FARTHEST = 1e6  # position that no unit makes one of a device [m]
STRONGEST = 1e9  # force that no unit makes one of a device [N]
LARGEST_FORCE = 1000.0  # force beyond which another unit was probably meant [N]
_MOST_MISSING = 1.0 / 3.0  # share of rows without a number up to which these are gaps


@dataclass(frozen=True)
class ImportedSamples:
    """Samples of a device, of one to three axes, in SI units.

    Attributes
    ----------
    period : float
        Sampling period [s].
    seq : numpy.ndarray
        Tick of each sample, ascending from the first, shape (N,).
    stamp : numpy.ndarray
        Time of each sample [s], shape (N,).
    position : numpy.ndarray
        Positions, zero on other axes [m], shape (N, 3).
    force : numpy.ndarray or None
        Force handed over at each sample, held until the next [N], shape (N, 3); None without one.
    axes : str
        Axes that the file has, of ``xyz``.
    sources : dict of str to str
        Which columns and factors each quantity was read from, for a person.
    """

    period: float
    seq: np.ndarray[Any, np.dtype[np.int64]]
    stamp: Array
    position: Array
    force: Array | None
    axes: str
    sources: dict[str, str]


def samples_of(
    table: ForeignTable,
    *,
    columns: Mapping[str, Sequence[str]] | None = None,
    units: Mapping[str, str] | None = None,
    rate: float | None = None,
    axis: str | None = None,
    ignore_times: bool = False,
) -> ImportedSamples:
    """Return the samples in a table.

    Parameters
    ----------
    table : ForeignTable
        Columns of a file.
    columns : mapping of str to sequence of str, optional
        Columns of ``position`` and ``force``, one or three of each, and of ``time``; without it,
        columns of the usual names.
    units : mapping of str to str, optional
        Unit of ``position``, ``force`` and ``time``: a name, or its value in SI as a number.
    rate : float, optional
        Sampling rate [Hz]; needed without a column of times.
    axis : str, optional
        Axis of a single column of positions; by default the one its name says, else ``x``.
    ignore_times : bool
        Whether each row is a tick at `rate`, whatever a column of times says.

    Returns
    -------
    ImportedSamples
        The samples, in SI units.

    Raises
    ------
    RecordError
        If a column is missing or ambiguous, values are missing, or times are uneven; the text says
        what was probably meant.
    """
    import numpy as np

    chosen = checked_columns(table, columns or {})
    given = checked_units(table, units or {})
    where = chosen.get("position") or vector_of(table, "position", "x")
    if not where:
        raise RecordError(
            f"{table.path}: which column is the position? There are"
            f" {table.names}; choose with {words.get().columns({'position': 'NAME'})}, or"
            f" {words.get().columns({'position': 'X:Y:Z'})} for three axes"
        )
    if len(where) == 1:
        where = {axis or next(iter(where)) or "x": next(iter(where.values()))}
    pushed = chosen.get("force") or vector_of(table, "force", "")
    if len(pushed) == len(where) == 1:
        pushed = dict(zip(where, pushed.values(), strict=True))
    if set(pushed) - set(where):
        raise RecordError(
            f"{table.path}: the force is {', '.join(pushed.values())}, the position"
            f" {', '.join(where.values())}; name the same axes of both:"
            f" {words.get().columns({'position': 'X:Y:Z', 'force': 'FX:FY:FZ'})}"
        )
    sources: dict[str, str] = {}
    own = is_own(table)
    name = time_column(table, chosen)
    kept = None
    if name is not None and not ignore_times and not own:
        kept = _kept(table, name, where.values(), pushed.values())
    if kept is not None:
        first = table.place(int(np.argmin(kept)))
        gaps = f"{np.sum(~kept)} rows without a number, the first at {first}"
        table = table.of_rows(kept)
    position = _filled(table, "position", where, given, sources)
    force = _filled(table, "force", pushed, given, sources) if pushed else None
    if kept is not None:
        sources["gaps"] = gaps
    refuse_unlikely(table, position, force, given)
    if name is None or ignore_times:
        if rate is None and ignore_times:
            raise RecordError(
                f"{table.path}: without its times the rate is needed: {words.get().rate('HZ')}"
            )
        if rate is None:
            raise _without_times(table)
        refuse_rate(table, rate)
        period = 1.0 / rate
        seq = np.arange(len(position))
        stamp = np.multiply(seq, period, dtype=np.float64)
        sources["time"] = f"rows at {rate:g} Hz"
    else:
        if own:
            name = "stamp"
        period, seq, stamp = ticks_of(table, name, rate, given, sources)
        if len(seq) != len(position):
            raise RecordError(
                f"{table.path}: {len(seq)} times in {name!r} and {len(position)} positions"
            )
    return ImportedSamples(
        period, seq, stamp, position, force, "".join(sorted(where)), sources
    )


def motion_of(
    table: ForeignTable,
    *,
    columns: Mapping[str, Sequence[str]],
    units: Mapping[str, str],
    rate: float | None,
) -> tuple[Array, Array, str]:
    """Return times and positions of a table whose times may be uneven.

    Parameters
    ----------
    table : ForeignTable
        Columns of a file.
    columns, units : mapping
        As of `samples_of`; a force is not read.
    rate : float or None
        Rows per second [Hz]; needed without a column of times.

    Returns
    -------
    time : numpy.ndarray
        Times since the first row [s], shape (N,).
    position : numpy.ndarray
        Positions [m], shape (N, 3).
    axes : str
        Axes that the file has, of ``xyz``.

    Raises
    ------
    RecordError
        As `samples_of`.
    """
    import numpy as np

    chosen = checked_columns(table, columns)
    given = checked_units(table, units)
    where = chosen.get("position") or vector_of(table, "position", "x")
    if not where:
        raise RecordError(
            f"{table.path}: which column is the position? There are"
            f" {table.names}; choose with {words.get().columns({'position': 'NAME'})}"
        )
    where = {axis or "x": name for axis, name in where.items()}
    sources: dict[str, str] = {}
    name = time_column(table, chosen)
    kept = None if name is None else _kept(table, name, where.values(), ())
    known = table if kept is None else table.of_rows(kept)
    position = _filled(known, "position", where, given, sources)
    refuse_unlikely(known, position, None, given)
    if name is None:
        if rate is None:
            raise _without_times(table)
        refuse_rate(table, rate)
        return np.arange(len(position)) / rate, position, "".join(sorted(where))
    since, factor, _ = growing(table, name, given)
    step = float(np.median(np.diff(since)))
    if "time" not in given and factor == 1.0:
        refuse_unlikely_time(table, name, step, rate)
    if rate is not None and abs(rate * step * factor - 1.0) > RATE_TOLERANCE:
        raise RecordError(
            f"{table.path}: rate {rate:g}, while column {name!r} advances"
            f" {1.0 / (step * factor):.6g} times a second; which one is it?"
            f"{unit_hint(step, rate)}"
        )
    since = since if kept is None else since[kept]
    if len(since) != len(position):
        raise RecordError(
            f"{table.path}: {len(since)} times in {name!r} and {len(position)} positions"
        )
    return since * factor, position, "".join(sorted(where))


def _without_times(table: ForeignTable) -> RecordError:
    return RecordError(
        f"{table.path}: no column of times among {table.names}; say the rate"
        f" with {words.get().rate('HZ')}, or the column with"
        f" {words.get().columns({'time': 'NAME'})}"
    )


def _filled(
    table: ForeignTable,
    role: str,
    where: Mapping[str, str],
    given: Mapping[str, tuple[str, float]],
    sources: dict[str, str],
) -> Array:
    """Return the vectors of a role in SI units, shape (N, 3)."""
    import numpy as np

    lengths = {name: len(table.numbers(name)) for name in where.values()}
    if len(set(lengths.values())) > 1:
        raise RecordError(f"{table.path}: columns of different lengths: {lengths}")
    found = np.zeros((next(iter(lengths.values())), 3))
    told = []
    for part, name in where.items():
        factor, source = factor_in(table, role, name, given)
        values = table.numbers(name).astype(np.float64)
        if (bad := np.flatnonzero(~np.isfinite(values))).size and not (
            role == "force" and (is_own(table) or bad.tolist() == [len(values) - 1])
        ):
            raise RecordError(
                f"{table.path}: {table.place(int(bad[0]))}, column {name!r}: no number"
                f" ({bad.size} such rows of {len(values)});"
                f"{_remedy(values, _MOST_MISSING * len(values))}"
            )
        found[:, "xyz".index(part)] = values * factor
        told.append(source)
    sources[role] = ", ".join(told)
    return found


def _remedy(values: Array, most: float) -> str:
    """Return what to do about numbers that are missing or infinite."""
    import numpy as np

    missing = int(np.isnan(values).sum())
    if missing == len(values):
        return f" choose others with {words.get().columns({'position': 'NAME'})}"
    if missing > most:
        return (
            " are its columns of different rates? Import one of them alone, or remove"
            " these rows"
        )
    if missing:
        return " remove these rows, or add a column of times, with which they are gaps"
    return " remove these rows: with a column of times they are read as gaps"


def _kept(
    table: ForeignTable, time: str, places: Iterable[str], forces: Iterable[str]
) -> Kept | None:
    """Return which rows have all numbers, None for all; of many missing ones none is a gap."""
    import numpy as np

    columns = [table.numbers(name) for name in places]
    # The force of the last row is never reported.
    columns += [np.append(table.numbers(name)[:-1], 0.0) for name in forces]
    if {len(column) for column in columns} != {len(table.numbers(time))}:
        return None  # refused by their lengths
    missing = np.zeros(len(columns[0]), dtype=np.bool_)
    for column in columns:
        missing |= np.isnan(column)
    few = 0 < int(missing.sum()) <= _MOST_MISSING * len(missing)
    return ~missing if few else None


def refuse_unlikely(
    table: ForeignTable,
    position: Array,
    force: Array | None,
    given: Mapping[str, tuple[str, float]] | None = None,
) -> None:
    """Raise RecordError for values that no device reaches, unless their unit was given.

    Parameters
    ----------
    table : ForeignTable
        Where they are from, for the text.
    position : numpy.ndarray
        Positions [m].
    force : numpy.ndarray or None
        Forces [N].
    given : mapping, optional
        Units that were given, by role.
    """
    import numpy as np

    given = given or {}
    if len(position) < 2:
        raise RecordError(f"{table.path}: {len(position)} rows; at least 2 are needed")
    _refuse_absurd(table, "position", position, FARTHEST, "m")
    span = float(np.ptp(position, axis=0).max())
    if span > LARGEST_SPAN and "position" not in given:
        raise _unlikely(table, "position", span, LARGEST_SPAN)
    if force is None:
        return
    _refuse_absurd(table, "force", force, STRONGEST, "N")
    largest = float(np.nanmax(np.abs(force), initial=0.0))
    if largest > LARGEST_FORCE and "force" not in given:
        raise _unlikely(table, "force", largest, LARGEST_FORCE)


def _unlikely(table: ForeignTable, role: str, size: float, limit: float) -> RecordError:
    """Return the refusal of values that are usual in another unit, which it asks about.

    How the unit is given is its remedy, as arrays have no units.
    """
    own, *others = UNITS[role]
    found, asked, so, name = {
        "position": ("the positions span", "are they", "they are", "metres"),
        "force": ("the largest force is", "is it", "it is", "newtons"),
    }[role]
    fault = f"{table.path}: {found} {size:.4g} {own}"
    as_is = words.get().unit(role, own)
    for unit in others:
        factor = UNITS[role][unit]
        if factor in (1e-3, 1e-6) and size * factor <= limit:
            fault += f"; {asked} in {unit} ({size * factor:.3g} {own})"
            way = (
                f"say so with {words.get().unit(role, unit)}, or {as_is} if {so} {name}"
            )
            break
    else:
        way = f"if these are {name}, say so with {as_is}"
    return RecordError(fault).with_remedies(Remedy(OTHER, way))


def _refuse_absurd(
    table: ForeignTable, role: str, values: Array, limit: float, unit: str
) -> None:
    """Refuse a number that is none of a device, in whatever unit it was given."""
    import numpy as np

    beyond = np.abs(values) > limit
    if beyond.any():
        row, axis = np.argwhere(beyond.reshape(len(values), -1))[0].tolist()
        found = values.reshape(len(values), -1)[row, axis]
        raise RecordError(
            f"{table.path}: {table.place(row)}: the {role} is {found:.4g} {unit}, of a device at"
            f" most {limit:g} {unit}; correct or remove that row"
        )
