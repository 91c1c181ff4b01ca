"""Windows of K: gaps between excluded intervals, divided where a member oscillates."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from nodes.laws import CompiledLaw
from nodes.stability.k_window import _divided, _gaps, outside
from nodes.stability.plant import Plant
from nodes.stability.worlds import AnyWorld, region_of


def test_gaps_are_divided_at_the_swings_inside_them() -> None:
    """Each part ends at a swing, with its frequency; the last keeps the end of the gap."""
    gaps = [(0.0, 10.0, 3.0), (20.0, math.inf, 2.0)]
    swings = [(7.0, 0.2), (3.0, 0.1), (3.0, 0.1), (10.0, 0.3), (15.0, 0.4), (20.0, 0.5)]
    assert _divided(gaps, [*swings, (30.0, 0.6)]) == [
        (0.0, 3.0, 0.1),
        (3.0, 7.0, 0.2),
        (7.0, 10.0, 3.0),
        (20.0, 30.0, 0.6),
        (30.0, math.inf, 2.0),
    ]
    assert _divided(gaps, []) == gaps


numbers = st.integers(-3, 3).map(float)


@given(
    st.lists(st.tuples(numbers, numbers, numbers), min_size=1, max_size=6),
    st.integers(0, 2),
)
def test_a_gap_is_where_every_quadratic_is_positive(
    terms: list[tuple[float, float, float]], floor: int
) -> None:
    """By sampling: a K is in a gap if and only if a K² + b K + c > 0 for all of them."""
    a, b, c = (np.array(column) for column in zip(*terms, strict=True))
    theta = np.linspace(0.1, 3.0, len(terms))
    gaps = _gaps(theta, a, b, c, float(floor))
    # Roots of small whole numbers are rational or irrational; these K are neither.
    for k in floor + np.arange(0.5, 200.0) * math.pi / 64.0:
        positive = bool(np.all((a * k + b) * k + c > 0.0))
        assert any(low < k < high for low, high, _ in gaps) == positive
    for low, high, _ in gaps:
        assert floor <= low < high


def test_a_law_on_the_boundary_of_a_region_is_not_outside() -> None:
    """No force at all is what a passive world may give: 0 > 0 at every frequency."""
    region = region_of(Plant(0.002, 0.1, 1.0), AnyWorld(), any_hand=False)
    for stiffness, is_outside in ((0.0, False), (1e-3, True), (-1e-3, False)):
        assert outside(CompiledLaw((stiffness,)), region) is is_outside
