"""A force field in words: its terms axis by axis, and what it adds to a law."""

from __future__ import annotations

import pytest

from nodes.coupling.field_judgement import field_text
from nodes.coupling.force_fields import Constant, Curl, Linear, NoField, Viscous
from nodes.laws.parse import compile_law, parse_law

T = 0.002
LAW = compile_law(parse_law({"kind": "pd", "stiffness": 1000.0, "damping": 3.0}), T)


@pytest.mark.parametrize(
    ("field", "axes", "text"),
    [
        (NoField(), "xy", ""),
        (Constant(force=(1.5, 0.0, -2.0)), "xyz", "F = (x: +1.5 N, z: -2 N)"),
        (Constant(force=(1.5, 0.0, -2.0)), "xy", "F = (x: +1.5 N)"),
        (Curl(gain=4.0, plane="xy"), "xy", "F = (x: +4 vy, y: -4 vx)"),
        (
            Viscous(gains=(2.0, 0.5, 0.0)),
            "xyz",
            "F = (x: -2 vx, y: -0.5 vy);"
            " the law is felt with K 1000 N/m, B 3.5 and 5 N s/m",
        ),
        (
            Linear(
                matrix=((0.0, 1.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
                force=(0.0, 0.25, 0.0),
            ),
            "xy",
            "F = (x: +1 vy, y: +0.25 N)",
        ),
    ],
)
def test_a_field_is_told_by_its_terms_that_are_not_zero(
    field: NoField | Constant | Curl | Viscous | Linear, axes: str, text: str
) -> None:
    assert field_text(field, LAW, T, axes) == text
