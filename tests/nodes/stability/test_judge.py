"""The verdict on a law: decay and growth, at the edge, with a spring and without."""

from __future__ import annotations

import pytest

from nodes.laws import CompiledLaw
from nodes.stability.judge import MARGINAL, judge
from nodes.stability.plant import Plant

T, MASS = 0.002, 0.1


def damper(damping: float) -> CompiledLaw:
    """Make a law that renders a damping [N s/m] and no spring: H(1) = 0."""
    return CompiledLaw((damping / T, -damping / T))


@pytest.mark.parametrize("share", [5e-4, 1e-4, 1e-5])
def test_without_any_spring_a_motion_may_not_grow(share: float) -> None:
    """The pole at z = 1 is the position, free for every law; the velocity's is 1 − B·T/m.

    By 5·10⁻⁴ a tick it grows by e in 4 s.
    """
    free = Plant(T, MASS, 0.0)
    grows, decays = (
        judge(damper(-share * MASS / T), free),
        judge(damper(share * MASS / T), free),
    )
    assert grows is not None
    assert decays is not None
    # The next term of the series is half the square, of a force that is a tick old.
    assert grows.pole_radius == pytest.approx(1.0 + share, abs=2.0 * share**2)
    assert not grows.stable
    assert decays.stable
    assert abs(decays.pole_radius - 1.0) < MARGINAL


def test_a_spring_to_ground_leaves_no_pole_at_one_to_excuse() -> None:
    """With 400 N/m, growth of 5·10⁻⁷ a tick is unstable, below the free loop's rounding."""
    share = 5e-7
    held = Plant(T, MASS, 0.0, 0.0, 400.0)
    grows = judge(damper(-2.0 * share * MASS / T), held)
    assert grows is not None
    assert 1.0 < grows.pole_radius < 1.0 + MARGINAL
    assert not grows.stable
