"""A law on a curved surface: what a history of deflections in the world's axes renders along it, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from messages.types import Proxy
from nodes.coupling.renderer import ActiveLaw, Renderer
from nodes.laws import Law
from nodes.laws.multi_term import MultiTerm, Term
from nodes.laws.pd import PD
from nodes.laws.pd_alpha import PDAlpha

PERIOD, RADIUS, DEPTH, SPEED = 0.002, 0.035, 2e-3, 0.2
LAWS: dict[str, Law] = {
    "pd": PD(stiffness=800.0, damping=2.0),
    "pd_alpha": PDAlpha(stiffness=800.0, damping=2.0, order=1.2, taps=10, gains="physical"),
    "multi_term": MultiTerm(
        stiffness=800.0,
        damping=2.0,
        terms=(Term(gain=1.0, order=1.2), Term(gain=0.5, order=0.8)),
        taps=10,
        gains="physical",
    ),
}


@pytest.mark.parametrize("name", LAWS)
def test_a_history_in_the_worlds_axes_pushes_along_a_curved_way(name: str) -> None:
    """Led round a sphere at one depth, nothing but the normal changes: tap j pulls by −h_j d sin(jθ) along the way."""
    law = LAWS[name].compile(PERIOD)
    renderer = Renderer([0, 1, 2], 16)
    renderer.law = ActiveLaw(name, name, law, renderer.histories)
    turn = SPEED * PERIOD / (RADIUS - DEPTH)
    along, across = [], []
    for k in range(40):
        normal = np.array([np.sin(k * turn), 0.0, np.cos(k * turn)])
        way = np.array([np.cos(k * turn), 0.0, -np.sin(k * turn)])
        message = Proxy(
            seq=k,
            stamp=0.0,
            position=tuple(((RADIUS - DEPTH) * normal).tolist()),
            proxy=tuple((RADIUS * normal).tolist()),
            normal=tuple(normal.tolist()),
            distance=-DEPTH,
            contact=True,
        )
        force = np.array(renderer.render(message))
        along.append(float(force @ way))
        across.append(float(force @ normal))
    taps = np.array(law.taps)
    ages = np.arange(len(taps)) * turn
    # Rounding of forces of some newtons, through deflections that are differences of positions.
    assert along[-1] == pytest.approx(-DEPTH * float(taps @ np.sin(ages)), abs=1e-9)
    assert across[-1] == pytest.approx(DEPTH * float(taps @ np.cos(ages)), abs=1e-9)
    # It pushes on: a damping of −B d/(r − d) on the way, which for a spring and damper is exact as the period goes to 0.
    assert along[-1] > 0.0
    if name == "pd":
        assert along[-1] == pytest.approx(2.0 * DEPTH * SPEED / (RADIUS - DEPTH), rel=turn**2)
    # In axes that turn with the normal all deflections are alike: the spring alone, and nothing along the way.
    assert across[-1] == pytest.approx(law.h1 * DEPTH, rel=0.01)
