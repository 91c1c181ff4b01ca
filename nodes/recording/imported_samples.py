"""Choose position, force and time among the columns of a foreign table, in SI units.

Units are those of the file or of the caller; nothing is converted without one of them. Values that
make no sense in SI units are refused, with the unit that was probably meant.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from messages.errors import OTHER, Remedy
from nodes.parameters.nearest import did_you_mean
from nodes.recording.facts import FASTEST, SLOWEST
from nodes.recording.foreign_table import ForeignTable
from nodes.recording.foreign_units import UNITS, factor_of, plain_name, suffix_unit
from nodes.recording.import_words import words
from nodes.recording.writer import RecordError

if TYPE_CHECKING:
    import numpy as np

    Array = np.ndarray[Any, np.dtype[np.float64]]
    Kept = np.ndarray[Any, np.dtype[np.bool_]]

ROLES = ("position", "force", "time")
LARGEST_SPAN = 2.0  # span of positions beyond which another unit was probably meant [m]
FARTHEST = 1e6  # position that no unit makes one of a device [m]
STRONGEST = 1e9  # force that no unit makes one of a device [N]
LARGEST_FORCE = 1000.0  # force beyond which another unit was probably meant [N]
UNEVEN = 0.25  # tolerated distance of a stamp from its tick [ticks]
ROUNDED = (
    0.45  # the same of rounded stamps; a missing row makes 0.5 − 0.75/rows [ticks]
)
RATE_TOLERANCE = (
    0.01  # tolerated difference between a given rate and that of the stamps
)

LONGEST_GAP = 86400.0  # gap between two rows beyond which a time is damaged [s]
_MOST_MISSING = 1.0 / 3.0  # share of rows without a number up to which these are gaps
_ROWS_OF_GAP = 1000.0  # rows that are missing in such a gap
_TOLD_BY_ALL = 32  # rows from which times are judged as a whole
SLOWEST_USUAL = 20.0  # rate below which another unit of time was probably meant [Hz]
ROUNDING = 1e-9  # a period this near to one of six digits is that one [share]

OWN_COLUMNS = (
    "seq",
    "stamp",
    "position_x",
    "force_x",
    "mean_force_x",
    "changed_at",
    "force_seq",
)
"""Columns by which a table of our own exports is recognised."""

_WHOLE = {
    "position": ("position", "pos", "displacement"),
    "force": ("force", "f"),
    "time": ("time", "t", "stamp", "timestamp"),
}
_PARTS = {"position": ("position", "pos", "p", ""), "force": ("force", "f")}


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

    chosen = _checked_columns(table, columns or {})
    given = _checked_units(table, units or {})
    where = chosen.get("position") or _vector(table, "position", "x")
    if not where:
        raise RecordError(
            f"{table.path}: which column is the position? There are"
            f" {table.names}; choose with {words.get().columns({'position': 'NAME'})}, or"
            f" {words.get().columns({'position': 'X:Y:Z'})} for three axes"
        )
    if len(where) == 1:
        where = {axis or next(iter(where)) or "x": next(iter(where.values()))}
    pushed = chosen.get("force") or _vector(table, "force", "")
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
    name = (
        next(iter(chosen["time"].values())) if "time" in chosen else _time_column(table)
    )
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
            raise RecordError(
                f"{table.path}: no column of times among {table.names}; say the rate"
                f" with {words.get().rate('HZ')}, or the column with"
                f" {words.get().columns({'time': 'NAME'})}"
            )
        _refuse_rate(table, rate)
        period = 1.0 / rate
        seq = np.arange(len(position))
        stamp = np.multiply(seq, period, dtype=np.float64)
        sources["time"] = f"rows at {rate:g} Hz"
    else:
        if own:
            name = "stamp"
        period, seq, stamp = _ticks(table, name, rate, given, sources)
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

    chosen = _checked_columns(table, columns)
    given = _checked_units(table, units)
    where = chosen.get("position") or _vector(table, "position", "x")
    if not where:
        raise RecordError(
            f"{table.path}: which column is the position? There are"
            f" {table.names}; choose with {words.get().columns({'position': 'NAME'})}"
        )
    where = {axis or "x": name for axis, name in where.items()}
    sources: dict[str, str] = {}
    name = (
        next(iter(chosen["time"].values())) if "time" in chosen else _time_column(table)
    )
    kept = None if name is None else _kept(table, name, where.values(), ())
    known = table if kept is None else table.of_rows(kept)
    position = _filled(known, "position", where, given, sources)
    refuse_unlikely(known, position, None, given)
    if name is None:
        if rate is None:
            raise RecordError(
                f"{table.path}: no column of times among {table.names}; say the rate"
                f" with {words.get().rate('HZ')}, or the column with"
                f" {words.get().columns({'time': 'NAME'})}"
            )
        _refuse_rate(table, rate)
        return np.arange(len(position)) / rate, position, "".join(sorted(where))
    since, factor, _ = _growing(table, name, given)
    step = float(np.median(np.diff(since)))
    if "time" not in given and factor == 1.0:
        _refuse_unlikely_time(table, name, step, rate)
    if rate is not None and abs(rate * step * factor - 1.0) > RATE_TOLERANCE:
        raise RecordError(
            f"{table.path}: rate {rate:g}, while column {name!r} advances"
            f" {1.0 / (step * factor):.6g} times a second; which one is it?"
            f"{_unit_hint(step, rate)}"
        )
    since = since if kept is None else since[kept]
    if len(since) != len(position):
        raise RecordError(
            f"{table.path}: {len(since)} times in {name!r} and {len(position)} positions"
        )
    return since * factor, position, "".join(sorted(where))


def is_own(table: ForeignTable) -> bool:
    """Whether a table was written by ``haptic bag export``."""
    return set(OWN_COLUMNS) <= set(table.columns)


def _checked_columns(
    table: ForeignTable, columns: Mapping[str, Sequence[str]]
) -> dict[str, dict[str, str]]:
    """Return the chosen columns by role and axis."""
    found: dict[str, dict[str, str]] = {}
    for role, names in columns.items():
        if role not in ROLES:
            raise RecordError(
                f"columns: {role!r} is none of {', '.join(ROLES)}{did_you_mean(role, ROLES)}"
            )
        if len(names) not in ((1,) if role == "time" else (1, 3)):
            raise RecordError(
                f"columns: {role} has {len(names)} columns, expected one"
                + ("" if role == "time" else " or three, as X:Y:Z")
            )
        for name in names:
            table.numbers(name)
        found[role] = dict(zip("xyz" if len(names) == 3 else ("",), names, strict=True))
    return found


def _checked_units(
    table: ForeignTable, units: Mapping[str, str]
) -> dict[str, tuple[str, float]]:
    """Return the given units by role: text and value in SI."""
    found = {}
    for role, text in units.items():
        if role not in ROLES:
            raise RecordError(
                f"units: {role!r} is none of {', '.join(ROLES)}{did_you_mean(role, ROLES)}"
            )
        factor = factor_of(role, text)
        if factor is None:
            known = ", ".join(UNITS[role])
            raise RecordError(
                f"{table.path}: units: {role} in {text!r}; known are {known}, or a number: the"
                f" value of 1 in {next(iter(UNITS[role]))}"
            )
        found[role] = (text, factor)
    return found


def _one(table: ForeignTable, role: str, names: list[str]) -> str | None:
    if len(names) > 1:
        raise RecordError(
            f"{table.path}: several columns may be the {role}: {', '.join(names)}; choose with"
            f" {words.get().columns({role: names[0]})}"
        )
    return names[0] if names else None


def _vector(table: ForeignTable, role: str, axis: str) -> dict[str, str]:
    """Return the columns of a vector by axis, found by their names."""
    plain = {name: plain_name(name) for name in table.columns}
    whole = [name for name in plain if plain[name] in _WHOLE[role]]
    found: dict[str, str] = {}
    for part in "xyz":
        wanted = {
            f"{base}{dash}{part}" for base in _PARTS[role] for dash in ("_", "") if base
        }
        wanted |= {part} if "" in _PARTS[role] else set()
        candidates = [name for name in plain if plain[name] in wanted]
        one = _one(table, role, candidates + whole if candidates else [])
        found |= {part: one} if one is not None else {}
    one = None if found else _one(table, role, whole)
    return {axis: one} if one is not None else found


def _time_column(table: ForeignTable) -> str | None:
    plain = {name: plain_name(name) for name in table.columns}
    for wanted in _WHOLE["time"]:
        one = _one(table, "time", [name for name in plain if plain[name] == wanted])
        if one is not None:
            return one
    return None


def _factor(
    table: ForeignTable, role: str, name: str, given: Mapping[str, tuple[str, float]]
) -> tuple[float, str]:
    """Return the SI value of a column's unit, and where the unit comes from."""
    own = table.units.get(name, "") or suffix_unit(role, name)
    named = factor_of(role, own) if own else None
    if role in given:
        text, factor = given[role]
        if named is not None and not math.isclose(named, factor):
            raise RecordError(
                f"{table.path}: column {name!r} says [{own}], {words.get().unit(role, text)}; which"
                " one is it? Rename the column, or leave the option out"
            )
        return factor, f"{name} in {text}"
    if own and named is None:
        known = ", ".join(UNITS[role])
        raise RecordError(
            f"{table.path}: column {name!r} is in [{own}], which is unknown here for {role}; known"
            f" are {known}; give its value in {next(iter(UNITS[role]))} with"
            f" {words.get().unit(role, 'NUMBER')}"
        )
    if named is not None:
        return named, f"{name} in {own}"
    return 1.0, f"{name} in {next(iter(UNITS[role]))}"


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
        factor, source = _factor(table, role, name, given)
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
    given = given or {}
    import numpy as np

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
            fault += f"; {asked} in {unit} ({size * factor:.3g} {own})?"
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


def _refuse_rate(table: ForeignTable, rate: float) -> None:
    if not SLOWEST <= rate <= FASTEST:
        raise RecordError(
            f"{table.path}: a rate of {rate:g} Hz; expected {SLOWEST:g} to {FASTEST:g} Hz"
        )


def _ticks(
    table: ForeignTable,
    name: str,
    rate: float | None,
    given: Mapping[str, tuple[str, float]],
    sources: dict[str, str],
) -> tuple[float, Any, Array]:
    """Return the period, and tick and time of each row, from a column of times."""
    import numpy as np

    if is_own(table):
        return _own_ticks(table, _times(table, name), sources)
    since, factor, source = _growing(table, name, given)
    step = float(np.median(np.diff(since)))
    if "time" not in given and factor == 1.0:
        _refuse_unlikely_time(table, name, step, rate)
    own_period, ticks = _regular(table, name, since, step)
    period = own_period * factor
    _refuse_rate(table, 1.0 / period)
    if rate is not None and abs(rate * period - 1.0) > RATE_TOLERANCE:
        raise RecordError(
            f"{table.path}: {words.get().rate(f'{rate:g}')}, while column {name!r} advances"
            f" {1.0 / period:.6g} times a second; which one is it?"
            f"{_unit_hint(step, rate)}"
        )
    if rate is not None:
        period = 1.0 / rate
    seq = np.concatenate(([0.0], ticks)).astype(np.int64)
    begin = float(table.numbers(name)[0]) * factor
    sources["time"] = source + (f", from {begin:.9g} s on" if begin else "")
    return period, seq, since * factor


def _times(table: ForeignTable, name: str) -> Any:
    """Return a column of times as it is."""
    import numpy as np

    raw = table.numbers(name)
    if (bad := np.flatnonzero(~np.isfinite(raw))).size:
        raise RecordError(
            f"{table.path}: {table.place(int(bad[0]))}, column {name!r}: no time ({bad.size} such"
            f" rows of {len(raw)}); remove these rows, or read each row as a tick with"
            f" {words.get().ticks}"
        )
    return raw


def _growing(
    table: ForeignTable, name: str, given: Mapping[str, tuple[str, float]]
) -> tuple[Array, float, str]:
    """Return increasing times since the first row, the SI value of their unit, and its source."""
    import numpy as np

    raw = _times(table, name)
    factor, source = _factor(table, "time", name, given)
    # Integers are subtracted as such: nanoseconds since 1970 have more digits than a float.
    since = (raw - raw[0]).astype(np.float64)
    steps = np.diff(since)
    if (back := np.flatnonzero(steps <= 0.0)).size:
        same = not steps[back].any()
        raise RecordError(
            f"{table.path}: {table.place(int(back[0]) + 1)}, column {name!r}: the time does not"
            f" grow ({raw[back[0]]} to {raw[back[0] + 1]}; {back.size} such rows);"
            f" {'remove the repeated rows' if same else 'sort the rows'}, or read each row as a"
            f" tick with {words.get().ticks}"
        )
    longest = max(LONGEST_GAP / factor, _ROWS_OF_GAP * float(np.median(steps)))
    if (far := np.flatnonzero(steps > longest)).size:
        raise RecordError(
            f"{table.path}: {table.place(int(far[0]) + 1)}, column {name!r}: {raw[far[0]]} to"
            f" {raw[far[0] + 1]} is a gap of more than a day; import the parts beside it on their"
            f" own, or name the unit with {words.get().unit('time', 'UNIT')}"
        )
    return since, factor, source


def _own_ticks(
    table: ForeignTable, stamp: Array, sources: dict[str, str]
) -> tuple[float, Any, Array]:
    """Return period, tick and time of each row of our own export."""
    import numpy as np

    seq = table.numbers("seq")
    fractional = np.any(seq != np.rint(seq))
    if fractional or np.any(np.diff(seq) <= 0) or seq[0] < 0:
        raise RecordError(
            f"{table.path}: column 'seq' does not grow; of a run whose driver restarted, import"
            " one part"
        )
    lasted = stamp[-1] - stamp[0]
    period = float(lasted / (seq[-1] - seq[0]))
    period = 1.0 / table.rate if table.rate is not None else period
    if not period > 0.0:
        raise RecordError(f"{table.path}: column 'stamp' does not grow")
    _refuse_rate(table, 1.0 / period)
    rounded = float(f"{period:.6g}")
    sources["time"] = "stamp in s, seq"
    near = abs(rounded / period - 1.0) < ROUNDING
    return (
        rounded if near else period,
        seq.astype(np.int64),
        np.asarray(stamp, dtype=np.float64),
    )


def _unit_hint(step: float, rate: float | None = None) -> str:
    """Return the units of time in which a step is a usual rate, as a question; or nothing."""
    likely = []
    for unit, factor in UNITS["time"].items():
        found = 1.0 / (step * factor)
        if unit != "s" and (
            20.0 <= found <= 20e3 if rate is None else abs(found / rate - 1) < 0.1
        ):
            likely.append(f"{unit} ({found:.5g} Hz)")
    unit = likely[0].partition(" ")[0] if len(likely) == 1 else "UNIT"
    return (
        f" Is it in {' or '.join(likely)}? Say so with {words.get().unit('time', unit)}"
        if likely
        else ""
    )


def _refuse_unlikely_time(
    table: ForeignTable, name: str, step: float, rate: float | None
) -> None:
    if SLOWEST_USUAL <= 1.0 / step <= FASTEST:
        return
    named = f" Say its unit with {words.get().unit('time', 'UNIT')}"
    raise RecordError(
        f"{table.path}: column {name!r} grows by {step:g} a row, {1.0 / step:.4g} Hz if it is"
        f" seconds.{_unit_hint(step, rate) or named}, or {words.get().unit('time', 's')} if it is;"
        f" if it counts rows, add {words.get().ticks}"
    )


def _regular(
    table: ForeignTable, name: str, since: Array, step: float
) -> tuple[float, Array]:
    """Return the period that fits all times, and the tick of each row after the first.

    Times may have gaps but must be even.
    """
    import numpy as np

    steps = np.diff(since)
    counts = np.rint(steps / step)
    stray = np.abs(steps / step - counts)
    bad = np.flatnonzero((stray > UNEVEN) | (counts < 1))
    missing = counts.sum() != len(steps)
    if (bad.size or missing) and (even := _even_period(since)):
        return even, np.arange(1.0, len(since))
    if bad.size:
        raise RecordError(
            f"{table.path}: {table.place(int(bad[0]) + 1)}, column {name!r}: the times are uneven"
            f" ({bad.size} of {len(steps)} steps lie beside a multiple of {step:g}); resample the"
            f" data evenly, or, if each row is a tick, add {words.get().ticks}"
        )
    period = float(since[-1] / counts.sum())
    rounded = float(f"{period:.6g}")
    # Stamps are rounded, and so is their mean step.
    near = abs(rounded / period - 1.0) < ROUNDING
    return rounded if near else period, np.cumsum(counts)


def _even_period(since: Array) -> float:
    """Return the mean step of times of which none is far from its tick, or 0.

    Such are times in whole milliseconds at 300 Hz, whose steps are 3 and 4. A missing row would
    move all rows behind it by a whole tick, half of it to either side.
    """
    import numpy as np

    if len(since) < _TOLD_BY_ALL:
        return 0.0
    steps = np.diff(since)
    # Rounded times have two steps, beside which nothing is missing.
    two = np.isclose(steps, steps.min()) | np.isclose(steps, steps.max())
    ticks = np.arange(len(since))
    period = float(np.polyfit(ticks, since, 1)[0])
    beside = since / period - ticks
    stray = np.abs(beside - np.median(beside)).max()
    return period if stray < (ROUNDED if two.all() else UNEVEN) else 0.0
