"""Numbers of a law's description: by path, scaled, and rounded to three digits."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from nodes.coupling.law_numbers import numbers_of, scaled_law, with_numbers
from nodes.laws import CompiledLaw
from nodes.laws.suggested import rounded_towards

TREE = {
    "kind": "x",
    "taps": [1.5, -2.5],
    "count": 3,
    "terms": [{"gain": 4.0, "order": 0.5}, {"gain": 5.0, "on": True}],
}


def test_numbers_are_the_floats_by_their_path() -> None:
    assert numbers_of(TREE) == {
        "taps[0]": 1.5,
        "taps[1]": -2.5,
        "terms[0].gain": 4.0,
        "terms[0].order": 0.5,
        "terms[1].gain": 5.0,
    }
    doubled = with_numbers(TREE, lambda _, value: 2.0 * value)
    assert numbers_of(doubled) == {
        path: 2.0 * value for path, value in numbers_of(TREE).items()
    }
    assert with_numbers(TREE, lambda _, value: value) == TREE


def test_a_scaled_law_has_the_same_poles() -> None:
    law = CompiledLaw((1.0, -2.0), ((3.0, 4.0, -0.5, 0.25),))
    assert scaled_law(law, 8.0) == CompiledLaw(
        (8.0, -16.0), ((24.0, 32.0, -0.5, 0.25),)
    )


@pytest.mark.parametrize(
    ("value", "towards", "rounded"),
    [
        (1234.0, 0.0, 1230.0),
        (1234.0, 2000.0, 1240.0),
        (-1234.0, 0.0, -1230.0),
        (-1234.0, -2000.0, -1240.0),
        (0.0056789, 0.0, 0.00567),
        (0.0056789, 1.0, 0.00568),
        (1000.0, 0.0, 1000.0),
        (999.9, 2000.0, 1000.0),
        (0.0, 1.0, 0.0),
    ],
)
def test_a_suggestion_has_three_digits(
    value: float, towards: float, rounded: float
) -> None:
    assert rounded_towards(value, towards) == pytest.approx(rounded, rel=1e-12)


@given(st.floats(1e-6, 1e6), st.booleans(), st.booleans())
def test_rounding_goes_the_right_way_by_less_than_a_unit(
    size: float, negative: bool, up: bool
) -> None:
    value = -size if negative else size
    found = rounded_towards(value, value + (1.0 if up else -1.0))
    # A unit of the third digit is at most a hundredth of the value; the quotient rounds, 1e-12.
    assert -1e-12 * size <= (found - value if up else value - found) <= 0.01001 * size
