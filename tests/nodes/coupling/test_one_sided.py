"""One-sided laws act along the normal: on inclined surfaces as on axis-aligned ones."""

from __future__ import annotations

import numpy as np
import pytest

from messages.types import Proxy
from nodes.coupling.renderer import ActiveLaw, Renderer
from nodes.environment.shapes.scene import rotation
from nodes.laws.pd import PD
from tests.support.shapes import Array

PERIOD = 0.002


def rendered(path: Array, turn: Array, raw: bool, clamp: bool) -> Array:
    """Return forces on a path over the floor, all rotated."""
    renderer = Renderer([0, 1, 2], 16)
    renderer.state.raw, renderer.state.clamp = raw, clamp
    renderer.law = ActiveLaw(
        "pd",
        "pd",
        PD(stiffness=500.0, damping=20.0).compile(PERIOD),
        renderer.histories,
    )
    forces = []
    for k, point in enumerate(path):
        contact = bool(point[2] < 0.0)
        # Friction holds it back at x = 0.
        on = np.array([0.0, point[1], 0.0]) if contact else point
        normal = turn @ (0.0, 0.0, 1.0)
        told = [tuple((turn @ vector).tolist()) for vector in (point, on)]
        forces.append(
            renderer.render(
                Proxy(
                    seq=k,
                    stamp=0.0,
                    position=told[0],
                    proxy=told[1],
                    normal=tuple(normal.tolist()),
                    distance=float(point[2]),
                    contact=contact,
                )
            )
        )
    return np.array(forces)


@pytest.mark.parametrize("raw", [False, True])
def test_a_surface_that_leans_is_a_floor_turned(raw: bool) -> None:
    """Pressed in, drawn along, and pulled out so fast that the law would pull."""
    way = np.linspace(0.0, 1.0, 40)[:, None]
    path = np.concatenate(
        [
            way * (0.004, 0.0, -0.012) + (0.0, 0.0, 0.002),
            (1.0 - way) * (0.004, 0.0, -0.01),
        ]
    )
    turn = np.array(rotation((0.5, -0.7, 0.9)))
    level, leaning = (
        rendered(path, np.eye(3), raw, True),
        rendered(path, turn, raw, True),
    )
    # Rounding of products of order one.
    assert np.abs(leaning - level @ turn.T).max() < 1e-12
    held = rendered(path, np.eye(3), raw, False)[:, 2] < 0.0
    assert held.sum() > 10
    assert (level[held, 2] == 0.0).all()
    # Along the surface nothing is taken off.
    assert np.abs(level[held, 0]).max() > 0.1
