"""What a device feels of a law in a region, in words: stiffness and damping at rest."""

from __future__ import annotations

import pytest

from nodes.base.setup import Effect
from nodes.coupling.felt_law import effective
from nodes.laws.parse import compile_law, parse_law

T = 0.002


@pytest.mark.parametrize(
    ("effect", "text"),
    [
        (Effect(name="e"), "K 1000 N/m, B 3 N s/m"),
        (Effect(name="e", stiffness=0.5, damping=0.25), "K 500 N/m, B 0.75 N s/m"),
        # A lag of 10 ms makes a damper of a spring: K τ.
        (Effect(name="e", stiffness=0.5, damping=0.25, lag=0.01), "K 0 N/m, B 5 N s/m"),
        (
            Effect(name="e", stiffness=0.5, damping=0.25, line=True),
            "K 500 N/m, B 0.75 N s/m, and −500 N/m from half its reach on",
        ),
        (
            Effect(name="e", stiffness=0.5, damping=0.25, lag=0.01, line=True),
            "K 500 N/m, B 10.8 N s/m, and −500 N/m from half its reach on",
        ),
    ],
)
def test_stiffness_and_damping_of_slow_motion(effect: Effect, text: str) -> None:
    """A PD of 1000 N/m and 3 N s/m has those at rest."""
    law = compile_law(parse_law({"kind": "pd", "stiffness": 1000.0, "damping": 3.0}), T)
    assert effective(law, effect, T) == text
