"""Read a LabVIEW measurement file (LVM): text with a header, and one of each segment.

Layout: National Instruments, "Specification for the LabVIEW Measurement File (.lvm)".
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from nodes.recording.foreign_units import split_unit
from nodes.recording.writer import RecordError

if TYPE_CHECKING:
    import numpy as np

    Column = np.ndarray[Any, Any]

TIME = "time"
_END = "***End_of_Header***"
_DELIMITERS = ("\t", ",", ";")
_UNITS = "Y_Unit_Label"
_LONGEST = 1e12  # start or step that a file may have [s]


class LvmTable(NamedTuple):
    """Columns of texts by name, the units of the file, and the line of each row."""

    columns: dict[str, Column]
    units: dict[str, str]
    lines: Sequence[int]


def is_lvm(text: str) -> bool:
    """Whether a text is a LabVIEW measurement file."""
    return text.startswith("LabVIEW Measurement")


def read_lvm(path: Path, text: str) -> LvmTable:
    """Return the channels of an LVM file of one segment, and their times.

    Parameters
    ----------
    path : Path
        The file, for errors.
    text : str
        Its content.

    Returns
    -------
    LvmTable
        ``time`` [s], from the X values or else from the segment's ``X0`` and ``Delta_X``, and a
        column per channel.

    Raises
    ------
    RecordError
        If it has no segment or several, or a row has too few fields.
    """
    import numpy as np

    lines = text.splitlines()
    ends = [row for row, line in enumerate(lines) if line.startswith(_END)]
    if len(ends) != 2:
        found = f"{max(len(ends) - 1, 0)} segments"
        raise RecordError(
            f"{path}: {found} with a header each; one is read here: import the parts on their own"
        )
    delimiter = next(
        (
            one
            for one in _DELIMITERS
            if any(line.startswith(f"Separator{one}") for line in lines[: ends[0]])
        ),
        "\t",
    )
    general = _header(lines[: ends[0]], delimiter)
    comma = (general.get("Decimal_Separator") or [""])[0] == ","
    segment = _header(lines[ends[0] + 1 : ends[1]], delimiter)
    dimensions = {one for one in segment.get("X_Dimension", ()) if one} - {"Time"}
    if dimensions:
        raise RecordError(f"{path}: its X values are {min(dimensions)}, not times")
    rows = [
        (number, row)
        for number, row in enumerate(
            _split(lines[ends[1] + 1 :], delimiter), ends[1] + 2
        )
        if any(field.strip() for field in row)
    ]
    if len(rows) < 2:
        raise RecordError(f"{path}: has no rows below its last header")
    (_, head), *rows = rows
    fields = [[*row, *[""] * (len(head) - len(row))] for _, row in rows]
    if wide := [
        number
        for (number, _), row in zip(rows, fields, strict=True)
        if len(row) > len(head)
    ]:
        raise RecordError(
            f"{path}: line {wide[0]} has more fields than the {len(head)} names"
        )
    if comma:
        fields = [[field.replace(",", ".") for field in row] for row in fields]
    table = np.array(fields, dtype=object).reshape(-1, len(head))
    channels = [
        place
        for place, name in enumerate(head)
        if name not in ("X_Value", "Comment", "")
    ]
    columns: dict[str, Column] = {}
    units: dict[str, str] = {}
    for of_channel, place in enumerate(channels):
        name, unit = split_unit(head[place])
        name = name if name not in (*columns, TIME) else f"{name} (column {place + 1})"
        columns[name] = table[:, place]
        labels = segment.get(_UNITS, [])
        unit = unit or (labels[of_channel] if of_channel < len(labels) else "")
        units |= {name: unit} if unit else {}
    x_values = [place for place, name in enumerate(head) if name == "X_Value"]
    given = [
        place for place in x_values if any(field.strip() for field in table[:, place])
    ]
    if any(np.any(table[:, place] != table[:, given[0]]) for place in given[1:]):
        raise RecordError(
            f"{path}: its channels have times of their own; write it in LabVIEW with one X column"
        )
    time = table[:, given[0]] if given else _times(path, segment, len(rows), comma)
    return LvmTable({TIME: time, **columns}, {TIME: "s", **units}, [n for n, _ in rows])


def _split(lines: Sequence[str], delimiter: str) -> list[list[str]]:
    return [
        [field.strip() for field in row]
        for row in csv.reader(lines, delimiter=delimiter)
    ]


def _header(lines: Sequence[str], delimiter: str) -> dict[str, list[str]]:
    """Return the values of a header by key."""
    return {row[0]: row[1:] for row in _split(lines, delimiter) if row}


def _times(
    path: Path, segment: Mapping[str, Sequence[str]], count: int, comma: bool
) -> Column:
    """Return the times of a segment without X values, from its start and step [s]."""
    import numpy as np

    def number(key: str) -> float:
        values = {
            text.replace(",", ".") if comma else text for text in segment.get(key, ())
        }
        values.discard("")
        try:
            (value,) = map(float, values)
        except ValueError:
            raise RecordError(
                f"{path}: has no X values, and its header no {key} of all channels"
            ) from None
        if not abs(value) <= _LONGEST:
            raise RecordError(
                f"{path}: {key} is {value:g} s, expected at most {_LONGEST:g} s"
            )
        return value

    return number("X0") + number("Delta_X") * np.arange(count)
