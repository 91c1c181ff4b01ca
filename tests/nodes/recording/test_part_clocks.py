"""Times of a recording's parts: by the record of the clock, else by the stamps inside."""

from __future__ import annotations

import pytest

from nodes.recording.mcap_walk import RawMessage
from nodes.recording.part_clocks import PartClocks
from nodes.recording.wall_clock import record

SECOND = 10**9
NOTHING = b'{"text":"no stamp"}'


def message(publish: int, data: bytes = NOTHING, log: int = 0) -> RawMessage:
    return RawMessage(1, 7, log, publish, data)


def stamped(seq: int, stamp: float) -> bytes:
    return f'{{"seq":{seq},"stamp":{stamp!r},"force":[0,0,0]}}'.encode()


def test_a_record_restores_log_time_and_stamp_whatever_the_message_says() -> None:
    clocks = PartClocks()
    clocks.set(2, record(5 * SECOND, 3 * SECOND))
    one = message(4 * SECOND, stamped(9, 77.0), log=6 * SECOND)
    assert clocks.count(2, one) == (7, 1.0)
    assert clocks.log_time(2, one) == 1.0
    assert clocks.stamp_ns(2, one, is_ours=True) == SECOND
    assert clocks.first == (5 * SECOND, 3 * SECOND, True)


def test_without_a_record_the_first_stamp_sets_the_clock_of_its_part() -> None:
    clocks = PartClocks()
    first = message(10 * SECOND, stamped((1 << 32) + 4, 2.0), log=11 * SECOND)
    # the sequence of MCAP has 32 bits
    assert clocks.count(0, first) == (4, 2.0)
    assert clocks.log_time(0, first) == 3.0
    # messages without a stamp are placed by their publish times
    assert clocks.count(0, message(12 * SECOND)) == (7, 4.0)
    assert clocks.stamp_ns(0, message(12 * SECOND), is_ours=True) == 4 * SECOND
    # what is inside counts for messages of ours only, whatever they were published at
    late = message(12 * SECOND, stamped(6, 2.5))
    assert clocks.count(0, late) == (6, 2.5)
    assert clocks.stamp_ns(0, late, is_ours=True) == 2.5 * SECOND
    assert clocks.stamp_ns(0, late, is_ours=False) == 4 * SECOND


def test_a_record_at_the_end_counts_from_there_on() -> None:
    clocks = PartClocks()
    clocks.count(0, message(10 * SECOND, stamped(0, 0.0)))
    clocks.set(0, record(0, 8 * SECOND))
    assert clocks.count(0, message(10 * SECOND, stamped(3, 0.0))) == (7, 2.0)


def test_a_part_whose_first_message_has_no_stamp_keeps_the_times_of_the_file() -> None:
    clocks = PartClocks()
    assert clocks.first == (0, 0, True)
    assert clocks.count(0, message(2 * SECOND)) == (7, 2.0)
    # a part of which nothing was counted has the clock of the first
    clocks.set(0, record(0, SECOND))
    assert clocks.stamp_ns(5, message(3 * SECOND), is_ours=True) == 2 * SECOND


def test_a_damaged_record_is_refused() -> None:
    with pytest.raises(ValueError, match="without times"):
        PartClocks().set(0, {"log_time_offset_ns": "1"})
