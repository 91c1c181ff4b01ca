"""Choose columns and units of a foreign table: by name, or those of the usual names."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from nodes.parameters.nearest import did_you_mean
from nodes.recording.foreign_table import ForeignTable
from nodes.recording.foreign_units import (
    UNITS,
    factor_of,
    plain_name,
    split_unit,
    suffix_unit,
)
from nodes.recording.import_words import words
from nodes.recording.writer import RecordError

ROLES = ("position", "force", "time")

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
    "time": ("time", "t", "stamp", "timestamp", "timestamps"),
}
_PARTS = {"position": ("position", "pos", "p", ""), "force": ("force", "f")}


def is_own(table: ForeignTable) -> bool:
    """Whether a table was written by ``haptic bag export``."""
    return set(OWN_COLUMNS) <= set(table.columns)


def checked_columns(
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
                + (
                    ""
                    if role == "time"
                    else f" or three: {words.get().columns({role: 'X:Y:Z'})}"
                )
            )
        names = [_without_unit(table, name) for name in names]
        for name in names:
            table.numbers(name)
        found[role] = dict(zip("xyz" if len(names) == 3 else ("",), names, strict=True))
    return found


def _without_unit(table: ForeignTable, name: str) -> str:
    """Return the name of a column that is named as the file does, with its unit."""
    plain, unit = split_unit(name)
    as_written = name not in table.columns and unit and table.units.get(plain) == unit
    return plain if as_written else name


def checked_units(
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


def vector_of(table: ForeignTable, role: str, axis: str) -> dict[str, str]:
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


def time_column(
    table: ForeignTable, chosen: Mapping[str, Mapping[str, str]]
) -> str | None:
    """Return the column of times, chosen or by the usual names; None without one."""
    if "time" in chosen:
        return next(iter(chosen["time"].values()))
    plain = {name: plain_name(name) for name in table.columns}
    for wanted in _WHOLE["time"]:
        one = _one(table, "time", [name for name in plain if plain[name] == wanted])
        if one is not None:
            return one
    return None


def factor_in(
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
