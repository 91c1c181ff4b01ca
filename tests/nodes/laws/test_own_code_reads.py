"""How far back a law's own code reads: places, slices, and the deflections it is tried in."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import pytest

from nodes.laws.own_code_reads import reads_outside


@pytest.mark.parametrize(
    ("read", "count", "outside"),
    [
        (lambda ring, head: ring[head], 1, ""),
        (lambda ring, head: ring[head + 1], 1, "ring[head + 1]"),
        (lambda ring, head: ring[head + 1], 2, ""),
        (lambda ring, head: ring[head - 1], 2, "ring[head - 1]"),
        (lambda ring, head: sum(ring[head : head + 3]), 3, ""),
        (lambda ring, head: sum(ring[head : head + 3]), 2, "ring[head + 2]"),
        (lambda ring, head: sum(ring[head - 2 : head]), 2, "ring[head - 2]"),
        # An empty slice reads nothing; an open one, or a loop, all 64 + 4 n + 256 places.
        (lambda ring, head: sum(ring[head + 9 : head + 9]), 1, ""),
        (lambda ring, head: sum(ring[head:]), 2, "ring[head + 263]"),
        (lambda ring, head: sum(ring[: head + 1]), 2, "ring[head - 64]"),
        (lambda ring, head: sum(iter(ring)) + head, 2, "ring[head + 263]"),
        (lambda ring, head: 1.0 / 0.0 + head * len(ring), 1, ""),
    ],
)
def test_places_without_a_tap_are_named(
    read: Callable[[Any, int], float], count: int, outside: str
) -> None:
    assert reads_outside(read, count) == outside


@pytest.mark.parametrize(
    "reached",
    [
        lambda newest, before: newest == before == 0.0,
        lambda newest, before: newest == before > 0.0,
        lambda newest, before: newest > before > 0.0,
        lambda newest, before: newest == before < 0.0,
    ],
)
def test_code_is_tried_at_rest_in_contact_on_the_way_in_and_in_free_space(
    reached: Callable[[float, float], bool],
) -> None:
    def own(ring: Sequence[float], head: int) -> float:
        return ring[head + 7] if reached(ring[head], ring[head + 1]) else 0.0

    assert reads_outside(own, 2) == "ring[head + 7]"
    assert reads_outside(own, 8) == ""
