"""Times of the clock in tables of other programs; the oracle is Python's own strftime."""

from __future__ import annotations

import datetime

import pytest
from hypothesis import given
from hypothesis import strategies as st

from nodes.recording.foreign_clock import clock_times, is_clock

DATES = (
    *("%d.%m.%Y", "%d.%m.%y", "%d/%m/%Y", "%m/%d/%Y", "%m/%d/%y", "%d-%m-%Y"),
    *("%d-%b-%Y", "%d-%B-%Y", "%Y-%m-%d", "%Y/%m/%d", "%Y.%m.%d", "%Y-%b-%d"),
)
CLOCKS = (" %H:%M:%S.%f", ", %H:%M:%S,%f", " %I:%M:%S.%f %p", " %I:%M:%S.%f%p")
ISO = ("%Y-%m-%dT%H:%M:%S.%f", "%Y-%m-%dT%H:%M:%S.%fZ", "%Y%m%dT%H%M%S.%f")
ALL = (*ISO, *(date + clock for date in DATES for clock in CLOCKS))
EPOCH = datetime.datetime(1970, 1, 1)


def nanoseconds(time: datetime.datetime) -> int:
    return (time - EPOCH) // datetime.timedelta(microseconds=1) * 1000


@given(
    first=st.datetimes(datetime.datetime(2001, 1, 1), datetime.datetime(2068, 1, 1)),
    form=st.sampled_from(ALL),
    step=st.integers(1, 10**9),
    count=st.integers(2, 5),
)
def test_any_usual_form_gives_the_times_between_rows(
    first: datetime.datetime, form: str, step: int, count: int
) -> None:
    times = [first + k * datetime.timedelta(microseconds=step) for k in range(count)]
    texts = [time.strftime(form) for time in times]
    assert all(map(is_clock, texts))
    found = clock_times(texts)
    assert found is not None
    true = [nanoseconds(time) for time in times]
    assert [at - found[0] for at in found] == [at - true[0] for at in true]
    # The date is right, or left out where two orders fit the rows.
    assert found[0] in (true[0], true[0] % (86_400 * 10**9))
    if not any(form.startswith(slashed) for slashed in ("%d/", "%m/", "%d-%m")):
        assert found == true


@pytest.mark.parametrize(
    ("texts", "days"),
    [
        # The 13th of a month tells the order of all rows.
        (("12/02/2026 23:59:59", "13/02/2026 00:00:00"), 20_496.0),
        (("02/12/2026 23:59:59", "02/13/2026 00:00:00"), 20_496.0),
        # A day apart in one order, a month or a year apart in the others.
        (("05/06/2026 23:59:59", "05/07/2026 00:00:00"), 20_579.0),
        (("05/06/2026 23:59:59", "06/06/2026 00:00:00"), 20_609.0),
        (("26/11/27 23:59:59", "26/11/28 00:00:00"), 20_784.0),
        # The 5th of June, or the 6th of May.
        (("05/06/2026 23:59:58", "05/06/2026 23:59:59"), 0.0),
    ],
)
def test_the_order_of_a_date_is_that_of_rows_close_together(
    texts: tuple[str, str], days: float
) -> None:
    """Days since 1970 from the calendar: 2026-02-12 is day 20 496."""
    found = clock_times(texts)
    assert found is not None
    assert found[1] - found[0] == 10**9
    assert found[0] // (86_400 * 10**9) == days


@pytest.mark.parametrize(
    "text",
    [
        *("", "1.5", "10", "101530", "10:15", "10:60:00", "10:00:61", "25:00:00"),
        *("13:00:00 PM", "0:00:00 AM", "31.02.2026 10:00:00", "27.13.2026 10:00:00"),
        *("27-Foo-2026 10:00:00", "2026-11-27 10-00-00", "20261127 101530", "\x00"),
    ],
)
def test_other_texts_are_no_times(text: str) -> None:
    assert clock_times([text]) is None
    assert clock_times(["10:15:30", text]) is None


def test_noon_and_midnight_of_twelve_hours() -> None:
    texts = ["12:00:00 AM", "1:00:00 a.m.", "12:00:00 PM", "11:00:00 pm", "12:30:00 AM"]
    found = clock_times(texts)
    assert found == [round(h * 3600e9) for h in (0, 1, 12, 23, 24.5)]


@pytest.mark.parametrize(
    ("first", "other"),
    [
        ("12:00:00 AM", "12:00:01"),
        ("2026-10-25T02:00:00+02:00", "2026-10-25T02:00:01"),
        ("01.02.2026 10:00:00", "2026-02-01 10:00:01"),
        ("2026-02-01 10:00:00", "10:00:01"),
    ],
)
def test_times_of_two_forms_are_no_column_of_times(first: str, other: str) -> None:
    """What one form leaves out, the half of the day or the zone, shifts its rows."""
    assert clock_times([first, first]) is not None
    assert clock_times([other, other]) is not None
    assert clock_times([first, other]) is None
