"""Options of an import as the reader's interface writes them, for the errors of tables.

Tables are read from the command line, from Python and for a launch file's ``hand``. Their errors
name options, and each interface sets its own words for the time of a call.
"""

from __future__ import annotations

import shlex
from collections.abc import Callable, Mapping
from contextvars import ContextVar
from typing import Final, NamedTuple


class ImportWords(NamedTuple):
    """How one interface writes the options of an import."""

    # columns by role, axes joined by colons
    columns: Callable[[Mapping[str, str]], str]
    unit: Callable[[str, str], str]  # a role and its unit
    rate: Callable[[str], str]  # a rate [Hz], or a word for it
    ticks: str  # that each row is a tick, at a rate
    decimal_comma: str  # that numbers have decimal commas


def _as_options(columns: Mapping[str, str]) -> str:
    return "--columns " + shlex.quote(
        ",".join(f"{role}={name}" for role, name in columns.items())
    )


def _in_yaml(columns: Mapping[str, str]) -> str:
    lists = (
        f"{role}: [{name.replace(':', ', ')}]" if ":" in name else f"{role}: {name}"
        for role, name in columns.items()
    )
    return f"columns: {{{', '.join(lists)}}}"


def _unit_in_yaml(role: str, unit: str) -> str:
    text = f'"{unit}"' if unit == "NUMBER" else unit  # a number is a text, too
    return f"units: {{{role}: {text}}}"


COMMAND_LINE: Final = ImportWords(
    columns=_as_options,
    unit=lambda role, unit: f"--units {role}={unit}",
    rate=lambda hz: f"--rate {hz}",
    ticks="--rate HZ --ignore-times",
    decimal_comma="--decimal-comma",
)
PYTHON: Final = ImportWords(
    columns=lambda columns: f"columns={dict(columns)}",
    unit=lambda role, unit: f"units={{{role!r}: {unit!r}}}",
    rate=lambda hz: f"rate={hz}",
    ticks="rate=HZ, ignore_times=True",
    decimal_comma="decimal_comma=True",
)
LAUNCH_FILE: Final = ImportWords(
    columns=_in_yaml,
    unit=_unit_in_yaml,
    rate=lambda hz: f"rate: {hz}",
    ticks="rate: HZ without a column of times",
    decimal_comma="haptic bag import --decimal-comma, whose recording file: reads too",
)
HAND_IN_PYTHON: Final = PYTHON._replace(
    ticks='haptic.read(FILE, rate=HZ, ignore_times=True)["position"] and rate=HZ',
    decimal_comma='haptic.read(FILE, decimal_comma=True)["position"] and rate=HZ',
)
"""Of a hand's path, whose file has fewer options than one that is read."""

words: Final[ContextVar[ImportWords]] = ContextVar("words", default=COMMAND_LINE)
