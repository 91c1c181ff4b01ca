"""Frequencies near a law's poles: where they are and how close together."""

from __future__ import annotations

import math

import numpy as np
import pytest

from nodes.laws import CompiledLaw
from nodes.stability.resonances import resonances


@pytest.mark.parametrize("gap", [1e-2, 1e-6, 1e-14])
def test_a_narrow_pole_has_its_frequency_and_eighty_on_either_side(gap: float) -> None:
    """From a twentieth of its distance to the circle on, but not below a twentieth of 1e-12."""
    angle, radius = 1.0, 1.0 - gap
    law = CompiledLaw(
        (), ((1.0, 0.0, -2.0 * radius * math.cos(angle), radius * radius),)
    )
    theta = resonances(law)
    assert np.all((theta > 0.0) & (theta <= math.pi))
    assert np.all(np.diff(theta) > 0.0)
    # The angle of a root is known to some roundings over its sine.
    nearest = np.abs(theta - angle)
    assert nearest.min() < 1e-15 * 20
    away = np.sort(nearest)
    if gap == 1e-2:
        # Both roots of the pair have the same angle, so two steps out are the nearest.
        assert away[away > 1e-12][0] == pytest.approx(0.05 * gap, rel=1e-6)
        ratio = (math.pi / (0.05 * gap)) ** (1.0 / 79.0)
        below = np.sort(angle - theta[theta < angle - 1e-12])
        apart = below[below > 0.0505 * gap]
        assert apart[0] / (0.05 * gap) == pytest.approx(ratio, rel=1e-6)
    least = 0.05 * max(gap, 1e-12)
    assert away[away > 0.5 * least][0] < 1.5 * least + 1e-13


def test_a_real_pole_is_at_its_end_of_the_circle_and_no_section_has_none() -> None:
    slow = resonances(CompiledLaw((), ((1.0, 0.0, -0.9, 0.0),)))
    # Its own place, 0, is not a frequency; the other root, 0, adds a wide grid.
    assert slow[0] == pytest.approx(0.05 * 0.1, rel=1e-9)
    fast = resonances(CompiledLaw((), ((1.0, 0.0, 0.9, 0.0),)))
    assert fast[-1] == math.pi
    assert fast[-2] == pytest.approx(math.pi - 0.05 * 0.1, rel=1e-12)
    assert resonances(CompiledLaw((1.0, 2.0))).size == 0
