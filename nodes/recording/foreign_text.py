"""Read a table of text: CSV and its relatives, with what stands around the rows.

The rows begin at the first two lines of numbers. Their names are in the line before, in the line
before a line of units, or in the last comment; what stands above is not read. Blank lines and
comments are left out.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from nodes.recording.foreign_clock import is_clock
from nodes.recording.foreign_units import is_unit, split_unit
from nodes.recording.import_words import words
from nodes.recording.lvm_file import is_lvm, read_lvm
from nodes.recording.writer import RecordError

if TYPE_CHECKING:
    import numpy as np

    Column = np.ndarray[Any, Any]

_COMMA = re.compile(r"[+-]?\d+,\d+(?:[eE][+-]?\d+)?")
_COMMENTS = ("#", "%")
_DELIMITERS = ("\t", ";", "|", ",", None)  # None: white space
_SEARCHED = 200  # lines in which the first row is searched


class TextTable(NamedTuple):
    """Columns of texts by name, the units that the file names, and the line of each row."""

    columns: dict[str, Column]
    units: dict[str, str]
    lines: Sequence[int]


class _Line(NamedTuple):
    number: int  # in the file, from 1
    text: str


class _Layout(NamedTuple):
    """Where the rows begin, and what stands before them."""

    delimiter: str | None
    first: int  # index of the first row
    names: Sequence[str] | None  # None: the columns have no names
    units: Sequence[str] = ()


def read_text(path: Path, decimal_comma: bool) -> TextTable:
    """Read a table of text.

    Parameters
    ----------
    path : Path
        UTF-8, UTF-16 or Windows-1252; fields separated by commas, semicolons, bars, tabs or spaces.
    decimal_comma : bool
        Whether it writes 0,5 for 0.5.

    Returns
    -------
    TextTable
        Columns of texts.

    Raises
    ------
    RecordError
        If it is no text, or a line has too many or too few fields.
    """
    import numpy as np

    text = _decoded(path)
    if is_lvm(text):
        return TextTable(*read_lvm(path, text))
    lines, comments = _lines(text)
    if not lines:
        raise RecordError(f"{path}: is empty")
    layout = _layout(lines, comments)
    rows = list(_rows(path, lines[layout.first :], layout.delimiter))
    header = layout.names
    if header is None:
        header = [str(number + 1) for number in range(len(rows[0][1]))]
    header, fields = _without_end(header, [fields for _, fields in rows])
    numbers = [number for number, _ in rows]
    _refuse_ragged(path, header, fields, numbers, layout.delimiter)
    fields = _with_points(path, fields, numbers, decimal_comma)
    names, units = names_of(header)
    units |= {
        name: text.strip("[]() ")
        for name, text in zip(names, layout.units, strict=False)
        if is_unit(text.strip("[]() ")) and name not in units
    }
    table = np.array(fields, dtype=object).reshape(-1, len(names))
    columns = {name: table[:, place] for place, name in enumerate(names)}
    return TextTable(columns, units, numbers)


def names_of(header: Sequence[str]) -> tuple[list[str], dict[str, str]]:
    """Return the names of columns without units, made unique, and the units."""
    split = [split_unit(text) for text in header]
    plain = [name or str(place + 1) for place, (name, _) in enumerate(split)]
    names = [
        name if plain.count(name) == 1 else f"{name} (column {place + 1})"
        for place, name in enumerate(plain)
    ]
    units = {name: unit for name, (_, unit) in zip(names, split, strict=True) if unit}
    return names, units


def _decoded(path: Path) -> str:
    data = path.read_bytes()
    codes: tuple[str, ...] = ("utf-8-sig", "cp1252")
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        codes = ("utf-16",)
    elif data[1:400:2].strip(b"\0") == b"" != data[0:400:2].strip(b"\0"):
        codes = ("utf-16-le",)  # without a mark: every second byte is zero
    elif data[0:400:2].strip(b"\0") == b"" != data[1:400:2].strip(b"\0"):
        codes = ("utf-16-be",)
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


def _lines(text: str) -> tuple[list[_Line], list[_Line]]:
    """Return the lines that hold something, and the comments."""
    lines: list[_Line] = []
    comments: list[_Line] = []
    for number, line in enumerate(text.splitlines(), 1):
        if line.lstrip().startswith(_COMMENTS):
            comments.append(_Line(number, line.lstrip()))
        elif line.strip():
            lines.append(_Line(number, line))
    return lines, comments


def _split(line: str, delimiter: str | None) -> list[str]:
    """Return the fields of one line."""
    if delimiter is None:
        return re.split(r"\s+(?![\[(])", line.strip())  # a unit belongs to its name
    try:
        found = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))
    except (csv.Error, StopIteration):
        return []
    return [field.strip() for field in found]


def _is_number(text: str) -> bool:
    if _COMMA.fullmatch(text) or is_clock(text):
        return True
    try:
        float(text)
    except ValueError:
        return False
    return "_" not in text  # as Python alone writes 1_000


def _is_row(fields: Sequence[str]) -> bool:
    """Whether all fields are numbers, of which some may be missing."""
    given = [field for field in fields if field]
    return bool(given) and all(map(_is_number, given))


def _are_names(fields: Sequence[str], count: int) -> bool:
    """Whether a line names a number of columns; a delimiter may end one of both lines."""
    named = fields[:-1] if fields and not fields[-1] else fields
    return count - 1 <= len(named) <= count + 1 and not any(map(_is_number, named))


def _are_units(fields: Sequence[str]) -> bool:
    """Whether a line has units, which some columns may lack."""
    units = [field.strip("[]() ") for field in fields if field.strip("[]() -")]
    return bool(units) and all(map(is_unit, units))


def _continues(fields: Sequence[str], count: int) -> bool:
    """Whether a line may be the row after one of `count` numbers; one word above is none."""
    return len(fields) == count and (count > 1 or _is_row(fields))


def _layout(lines: Sequence[_Line], comments: Sequence[_Line]) -> _Layout:
    """Return where the rows begin: at the first two lines of as many numbers."""
    for first, line in enumerate(lines[:_SEARCHED]):
        for delimiter in _DELIMITERS:
            if delimiter is not None and delimiter not in line.text:
                continue
            row = _split(line.text, delimiter)
            after = lines[first + 1 : first + 2]
            if _is_row(row) and all(
                _continues(_split(text, delimiter), len(row)) for _, text in after
            ):
                return _named(lines, comments, delimiter, first, len(row))
    # No row is of numbers alone: one of its columns holds texts.
    present = [one for one in _DELIMITERS if one is None or one in lines[0].text]
    names = _split(lines[0].text, present[0])
    below = _split(lines[1].text, present[0]) if len(lines) > 1 else []
    if _are_units(below) and _are_names(names, len(below)):
        return _Layout(present[0], 2, names, below)
    return _Layout(present[0], 1, names)


def _named(
    lines: Sequence[_Line],
    comments: Sequence[_Line],
    delimiter: str | None,
    first: int,
    count: int,
) -> _Layout:
    """Return the layout of rows from `first` on: names are the line above, or a comment."""
    if first == 0:
        before = [line.text for line in comments if line.number < lines[0].number]
        for comment in reversed(before):
            told = _split(comment.lstrip("#% "), delimiter)
            if len(told) == count and not any(map(_is_number, told)):
                return _Layout(delimiter, 0, told)
        return _Layout(delimiter, 0, None)
    above = _split(lines[first - 1].text, delimiter)
    if first > 1:
        higher = _split(lines[first - 2].text, delimiter)
        if _are_units(above) and _are_names(higher, count):
            return _Layout(delimiter, first, higher, above)
    if _are_names(above, count):
        return _Layout(delimiter, first, above)
    if first > 1 and all(
        len(_split(text, delimiter)) != count for _, text in lines[:first]
    ):
        return _Layout(delimiter, first, None)  # words above, which name no columns
    # A row with a text stands above, or names of other columns: refused by its line.
    return _Layout(delimiter, 1, _split(lines[0].text, delimiter))


def _rows(
    path: Path, lines: Sequence[_Line], delimiter: str | None
) -> Iterator[tuple[int, list[str]]]:
    """Yield line and fields of each row."""
    if delimiter is None:
        for line in lines:
            yield line.number, line.text.split()
        return
    reader = csv.reader(
        (line.text for line in lines), delimiter=delimiter, skipinitialspace=True
    )
    begin = 0
    try:
        for fields in reader:
            _refuse_open_quote(path, lines[begin : reader.line_num], delimiter, fields)
            yield lines[begin].number, fields
            begin = reader.line_num
    except csv.Error as error:
        number = lines[begin].number
        raise RecordError(f"{path}: line {number}: is no CSV: {error}") from error


def _refuse_open_quote(
    path: Path, lines: Sequence[_Line], delimiter: str, fields: Sequence[str]
) -> None:
    """Raise RecordError for a row of several lines, of which a quote has taken in other rows."""
    if len(lines) == 1:
        return
    quotes = sum(line.text.count('"') for line in lines)
    taken = any(len(_split(line.text, delimiter)) == len(fields) for line in lines[1:])
    if quotes % 2 or taken:
        raise RecordError(
            f"{path}: line {lines[0].number}: a quote is not closed before line"
            f" {lines[-1].number}; close or remove it"
        )


def _without_end(
    header: Sequence[str], fields: list[list[str]]
) -> tuple[Sequence[str], list[list[str]]]:
    """Return names and rows without what a delimiter at the end of lines adds."""
    width = len(header)
    if header and not header[-1]:
        width -= 1
    if all(len(row) == width + 1 and not row[-1].strip() for row in fields):
        return header[:width], [row[:width] for row in fields]
    if width < len(header) and all(len(row) <= width for row in fields):
        return header[:width], fields
    return header, fields


def _refuse_ragged(
    path: Path,
    header: Sequence[str],
    fields: list[list[str]],
    numbers: Sequence[int],
    delimiter: str | None,
) -> None:
    for number, row in zip(numbers, fields, strict=True):
        if len(row) == len(header):
            continue
        hint = ""
        if delimiter == "," and len(row) > len(header):
            hint = (
                "; if its numbers have decimal commas, write it with semicolons between the"
                f" fields, and import it with {words.get().decimal_comma}"
            )
        elif number == numbers[-1]:
            hint = "; if the file was cut there, remove that line"
        raise RecordError(
            f"{path}: line {number} has {len(row)} fields, the first line"
            f" {len(header)}{hint}"
        )


def _with_points(
    path: Path, fields: list[list[str]], numbers: Sequence[int], decimal_comma: bool
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
    for number, row in zip(numbers, fields, strict=True):
        for text in row:
            if "," in text and _COMMA.fullmatch(text.strip()):
                raise RecordError(
                    f"{path}: line {number}: {text.strip()!r} has a decimal comma; read"
                    f" it as a number with {words.get().decimal_comma}"
                )
    return fields
