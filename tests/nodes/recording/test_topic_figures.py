"""Figures of a topic: gaps, restarts, the wrap of ``seq``, the rate."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from nodes.recording.topic_figures import TopicFigures

WRAP = 2**32


def counted(seqs: list[int], ticking: bool = True) -> TopicFigures:
    figures = TopicFigures()
    for n, seq in enumerate(seqs):
        figures.add(seq % WRAP, 0.5 * n, ticking)
    return figures


@given(st.integers(0, 2 * WRAP), st.lists(st.integers(1, 2**31 - 1), max_size=6))
def test_what_is_missing_between_the_first_and_the_last_is_a_gap(
    first: int, steps: list[int]
) -> None:
    """Also where ``seq``, which MCAP keeps modulo 2³², begins again."""
    seqs = [first]
    for step in steps:
        seqs.append(seqs[-1] + step)
    found = counted(seqs)
    assert found.messages == len(seqs)
    assert found.gaps == seqs[-1] - seqs[0] + 1 - len(seqs)
    assert found.back == 0
    assert found.last_seq - found.first_seq == seqs[-1] - seqs[0]


def test_what_does_not_rise_goes_back_once_and_is_no_gap() -> None:
    found = counted([5, 6, 6, 9, 0, 1, 3])
    assert (found.back, found.gaps, found.last_seq) == (2, 2 + 1, 3)
    # The largest step ahead, and the first that is one back.
    assert counted([0, 2**31 - 1]).gaps == 2**31 - 2
    assert counted([0, 2**31]).back == 1
    other = counted([5, 9, 2], ticking=False)
    assert (other.gaps, other.back, other.first_seq, other.last_seq) == (0, 0, 5, 2)


def test_the_rate_is_of_the_stamps_whatever_their_order() -> None:
    found = counted([1, 2, 3, 4, 5])
    assert (found.first_stamp, found.last_stamp, found.rate) == (0.0, 2.0, 2.0)
    assert counted([1]).rate == TopicFigures().rate == 0.0
    mixed = TopicFigures()
    for seq, stamp in enumerate((3.0, 1.0, 2.0)):
        mixed.add(seq, stamp, True)
    assert (mixed.first_stamp, mixed.last_stamp) == (1.0, 3.0)
    assert mixed.rate == pytest.approx(1.0)
