"""Shapes of suspects against closed forms: a dragged bristle, a mass loose in its gap."""

from __future__ import annotations

import numpy as np
import pytest

from sim.arrays import Array
from sim.identify.experiment import lockstep
from sim.identify.identified_motion import NAMES
from sim.identify.output_error import Fit
from sim.identify.suspects import Shapes

T = 0.002


def shapes(position: Array) -> Shapes:
    """Return the shapes of one window in which the model follows the recording."""
    nothing = np.zeros((1, 0))
    found = Fit(
        np.zeros(len(NAMES)),
        np.zeros(0, dtype=np.int64),
        np.zeros((1, 4)),
        np.zeros(1),
        nothing,
        nothing,
        np.zeros(1, dtype=np.int64),
        len(position),
    )
    force = np.zeros(len(position))
    return Shapes(lockstep(T, position, force), found, position[None])


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_bristle_slips_at_its_reach_and_bends_back_by_the_way(sign: float) -> None:
    """After a turn it is at its reach less the way back, down to its reach on the other side."""
    way, reach = 2.0**-16, 10 * 2.0**-16
    there = np.arange(40) * way
    back = there[-1] - np.arange(1, 41) * way
    (out,) = shapes(sign * np.concatenate([there, back]))._bristle(reach)
    assert list(sign * out[:40]) == [reach] * 40
    assert list(sign * out[40:]) == [max(reach - k * way, -reach) for k in range(1, 41)]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_loose_mass_coasts_through_its_gap_and_then_rests(sign: float) -> None:
    """The first mass stops; the second goes on at its speed until it hits the other side."""
    way = 2.0**-16
    gap = 20 * way
    moving = np.arange(40) * way
    (out,) = shapes(sign * np.concatenate([moving, np.full(40, moving[-1])]))._loose(
        gap
    )
    # The speed is a central difference, so half of the last step counts as a stop already.
    assert list(sign * out[:40]) == [0.5 * gap] * 40
    coasting = [0.5 * gap - (k - 0.5) * way for k in range(1, 41)]
    assert list(sign * out[40:]) == [max(one, -0.5 * gap) for one in coasting]
