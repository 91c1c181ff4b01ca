"""Times of the clock in tables of other programs, with or without a date, in nanoseconds.

A date may be written in several orders. Only the time between rows is needed: the order is the one
in which all rows are dates and lie closest together. Where two orders give the same times between
rows, the date remains unknown, and times count from the first midnight.
"""

from __future__ import annotations

import datetime
import functools
import re
from collections.abc import Iterable, Sequence
from typing import NamedTuple

_DATE = r"\d{1,4}(?P<dash>[-/.])(?:\d{1,2}|[A-Za-z]{3,9})(?P=dash)\d{1,4}|\d{8}(?=T)"
_CLOCK = re.compile(
    rf"(?:(?P<date>{_DATE})(?:[T ]|,? +))?"
    r"(?P<hour>\d{1,2})(?P<colon>:?)(?P<minute>\d\d)(?P=colon)(?P<second>\d\d)"
    r"(?:[.,](?P<part>\d{1,9}))?"
    r"(?: ?(?P<half>[AaPp])\.?[Mm]\.?)?"
    r"(?: ?(?P<zone>Z|UTC|[+-]\d\d:?\d\d))?"
)
_ALONE = re.compile(_DATE)
_MONTHS = (
    *("january", "february", "march", "april", "may", "june", "july", "august"),
    *("september", "october", "november", "december"),
)
_EPOCH = datetime.date(1970, 1, 1).toordinal()
_DAY = 86_400 * 1_000_000_000  # [ns]
_NONE: dict[str, int] = {"": 0}  # days since 1970 of a time without a date


class _Time(NamedTuple):
    """A time of the clock."""

    days: dict[str, int]  # days since 1970 by the order of the date's parts
    of_day: int  # time of the day, with its zone [ns]
    marks: tuple[bool, bool] = (False, False)  # whether it has AM or PM, and a zone


def is_date(text: str) -> bool:
    """Whether a text is a date without a time."""
    return bool(_ALONE.fullmatch(text) and _days(text))


def is_clock(text: str) -> bool:
    """Whether a text is a time of the clock, a date, or both."""
    return _read(text) is not None or is_date(text)


def clock_times(texts: Iterable[str]) -> list[int] | None:
    """Return times of the clock in nanoseconds.

    Parameters
    ----------
    texts : iterable of str
        ``10:15:30.5``, ``10:15:30 PM``, ``2026-11-27T10:15:30.123456Z``, ``27.11.2026 10:15:30``,
        ``11/27/2026 10:15:30 PM``, ``27-Nov-2026 10:15:30`` and the like.

    Returns
    -------
    list of int or None
        Times since 1970, or since the first midnight without a date, or with one of which day and
        month are not told apart [ns]; times without a date go on after midnight. None if a text is
        no time of the clock, or has another form than the first.
    """
    read: list[_Time] = []
    orders: set[str] | None = None
    for text in texts:
        time = _read(text.strip())
        if time is None or (read and time.marks != read[0].marks):
            return None
        orders = set(time.days) if orders is None else orders & set(time.days)
        if not orders:
            return None
        read.append(time)
    if orders is None:
        return None
    if orders == {""}:
        return _within(_after_midnights([time.of_day for time in read]))
    found = sorted(
        ([_DAY * time.days[order] + time.of_day for time in read] for order in orders),
        key=lambda times: (max(times) - min(times), times),
    )
    first, *others = found
    same = [times for times in others if _since(times) == _since(first)]
    if same and same[0] != first:
        first = [time - (first[0] // _DAY) * _DAY for time in first]
    return _within(first)


def _since(times: Sequence[int]) -> list[int]:
    return [time - times[0] for time in times]


def _within(times: list[int]) -> list[int] | None:
    """Return times that 64 bits hold; else None."""
    return times if max(map(abs, times)) < 1 << 63 else None


def _after_midnights(times: Sequence[int]) -> list[int]:
    """Return times without a date, of which one half a day before the last is of the next day."""
    found: list[int] = []
    days = 0
    for time in times:
        if found and time + days * _DAY < found[-1] - _DAY // 2:
            days += 1
        found.append(time + days * _DAY)
    return found


def _read(text: str) -> _Time | None:
    """Return a time of the clock; None for another text."""
    found = _CLOCK.fullmatch(text)
    if found is None or not (found["colon"] or found["date"]):
        return None
    days = _days(found["date"]) if found["date"] else _NONE
    hour, minute, second = (int(found[name]) for name in ("hour", "minute", "second"))
    if found["half"]:
        if not 1 <= hour <= 12:
            return None
        hour = hour % 12 + (12 if found["half"] in "Pp" else 0)
    if not days or hour > 24 or minute > 59 or second > 60:  # 60: a leap second
        return None
    zone = found["zone"]
    if zone and zone[0] in "+-":
        east = 60 * int(zone[1:3]) + int(zone[-2:])
        minute -= east if zone[0] == "+" else -east
    part = int((found["part"] or "0").ljust(9, "0"))
    of_day = (3600 * hour + 60 * minute + second) * 1_000_000_000 + part
    return _Time(days, of_day, (bool(found["half"]), bool(zone)))


@functools.lru_cache(maxsize=64)
def _days(text: str) -> dict[str, int]:
    """Return the days since 1970 of a date, by the order of its parts; empty for none.

    Years of two digits are of this century. Parts between dots begin with the day.
    """
    if text.isdigit():
        text = f"{text[:4]}-{text[4:6]}-{text[6:]}"
    first, second, third = re.split(r"[-/.]", text)
    if second.isalpha():
        names = [name[: len(second)] for name in _MONTHS]
        if second.lower() not in names:
            return {}
        second = str(names.index(second.lower()) + 1)
        orders: tuple[str, ...] = ("ymd",) if len(first) == 4 else ("dmy",)
    elif len(first) == 4:
        orders = ("ymd",)
    elif "." in text:
        orders = ("dmy",)
    else:
        orders = ("dmy", "mdy", "ymd")
    found = {}
    for order in orders:
        parts = dict(zip(order, (first, second, third), strict=True))
        if len(parts["y"]) not in (2, 4) or len(parts["d"]) > 2 or len(parts["m"]) > 2:
            continue
        year = int(parts["y"]) + (2000 if len(parts["y"]) == 2 else 0)
        try:
            day = datetime.date(year, int(parts["m"]), int(parts["d"]))
        except ValueError:
            continue
        found[order] = day.toordinal() - _EPOCH
    return found
