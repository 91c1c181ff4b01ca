"""Friction of a proxy: stick in the cone, slide on it; on flat, round and meshed surfaces."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from nodes.environment.node import Environment
from nodes.environment.shapes.mesh import prepare_mesh
from nodes.environment.shapes.scene import (
    Friction,
    Solid,
    box,
    capsule,
    mesh,
    plane,
    sphere,
)
from nodes.environment.shapes.tables import SKIN
from nodes.environment.shapes.touchable import TOOL_RADIUS
from sim.lab.proxy_shapes import icosphere
from sim.play.touch import Touched, touch
from tests.support.setups import setup_of
from tests.support.shapes import Array, wander

CONE = 1e-9
"""Allowed excess of the deflection over the friction cone, relative to its normal part."""


def led(solids: list[Solid], path: Array, tool: float = 0.0) -> Touched:
    return touch(solids, path, tool, interpreted=True)


def parts(found: Touched) -> tuple[Array, Array]:
    """Return normal and tangential part of the deflection in contact [m]."""
    deflection = (found.proxy - found.path)[found.contact]
    normal = np.einsum("ij,ij->i", deflection, found.normal[found.contact])
    return normal, np.linalg.norm(
        deflection - normal[:, None] * found.normal[found.contact], axis=1
    )


SURFACES: dict[str, Solid] = {
    "plane": plane((0.0, 0.0, 0.0), (0.2, 0.1, 1.0)),
    "sphere": sphere((0.0, 0.0, -0.02), 0.02),
    "capsule": capsule((-0.02, 0.0, -0.01), (0.02, 0.003, -0.01), 0.01),
    "box": box((0.0, 0.0, -0.005), (0.02, 0.03, 0.01), (0.1, 0.2, 0.3)),
    "mesh": mesh(prepare_mesh(icosphere(2, 0.02) - (0.0, 0.0, 0.02), False, "ball")),
}


@pytest.mark.parametrize("tool", [0.0, 5e-4])
@pytest.mark.parametrize("kind", SURFACES)
def test_the_cone_is_kept(kind: str, tool: float) -> None:
    """After every call on a random path; some calls stick, some slide."""
    friction = Friction(0.5, 0.4)
    path = wander(
        np.random.default_rng(2), 400, 1e-3, (0.01, 0.01, 0.004), (0.0, 0.0, 0.003)
    )
    found = led([SURFACES[kind]._replace(friction=friction)], path, tool)
    normal, along = parts(found)
    assert len(normal) > 100
    assert (along <= 0.5 * normal * (1.0 + CONE) + 1e-13).all()
    on_it = np.abs(along - 0.4 * normal) <= CONE * normal + 1e-13
    stuck = (
        np.linalg.norm(np.diff(found.proxy, axis=0), axis=1)[found.contact[1:]] == 0.0
    )
    assert on_it.sum() > 20
    assert stuck.sum() > 20


def test_it_sticks_up_to_the_static_coefficient_and_slides_at_the_dynamic_one() -> None:
    """Pressed 1 mm deep and drawn by 10 µm steps: breaks away at 0.6 mm, then trails 0.3 mm."""
    depth = 1e-3 + SKIN
    path = np.array([[0.0, 0.0, 0.01], *([1e-5 * k, 0.0, -1e-3] for k in range(120))])
    at = led([plane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), Friction(0.6, 0.3))], path).proxy[
        1:, 0
    ]
    # The straight way down leads from 0 to 0; then it is stuck until 0.6 depths.
    away = next(k for k in range(120) if at[k] > 0.0)
    assert away == math.floor(0.6 * depth / 1e-5) + 1
    assert np.abs(at[away:] - (path[1 + away :, 0] - 0.3 * depth)).max() < 1e-13


def test_a_viscous_surface_makes_it_trail_by_its_speed() -> None:
    """Drawn at v, the proxy lags by v times the given time in steady state."""
    speed, trails, period = 0.05, 0.008, 1e-3
    path = np.array(
        [[0.0, 0.0, 0.01], *([speed * period * k, 0.0, -1e-3] for k in range(200))]
    )
    found = led(
        [plane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), Friction(0.0, 0.0, trails))], path
    )
    # It approaches by 1/(1 + T/τ) a tick: after 200 ticks nothing is left of the beginning.
    assert path[-1, 0] - found.proxy[-1, 0] == pytest.approx(speed * trails, rel=1e-9)


def test_between_two_rough_walls_each_brakes_by_what_presses_on_it() -> None:
    """Along the crease of two perpendicular walls, pressed 2 mm on one and 1 mm on the other."""
    rough, smooth = Friction(0.5, 0.5), Friction(0.1, 0.1)
    walls = [
        plane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), rough),
        plane((0.0, 0.0, 0.0), (0.0, 1.0, 0.0), smooth),
    ]
    path = np.array([[0.0, 0.01, 0.01], *([1e-4 * k, -1e-3, -2e-3] for k in range(60))])
    behind = path[-1, 0] - led(walls, path).proxy[-1, 0]
    assert behind == pytest.approx(0.5 * (2e-3 + SKIN) + 0.1 * (1e-3 + SKIN), rel=1e-9)


@pytest.mark.parametrize("kind", ["sphere", "union"])
def test_friction_that_is_set_while_the_surface_is_touched_moves_no_proxy_that_it_holds(
    kind: str,
) -> None:
    """Stuck 0.4 mm beside its entry: a new proxy at the nearest point would jump."""
    ball: dict[str, Any] = {
        "kind": "sphere",
        "position": [0.0, 0.0, -0.02],
        "radius": 0.02,
        "friction": {"static": 0.8},
    }
    surface, path = (
        (ball, "")
        if kind == "sphere"
        else ({"kind": "union", "shapes": [ball]}, ".shapes[0]")
    )
    node = Environment(
        setup_of(
            name="environment", axes=["x", "y", "z"], parameters={"surface": surface}
        )
    )
    node.configure()
    for place in ((0.0, 0.0, 0.01), (0.0, 0.0, -1e-3), (4e-4, 0.0, -1e-3)):
        held = node._meet(place)
    assert held[0][0] == pytest.approx(0.0, abs=1e-12)

    def sets(**values: Any) -> None:
        changed = {f"surface{path}.{name}": value for name, value in values.items()}
        node.prepare(node.store.changed(changed))(0)

    for static in (1.5, 0.5):
        sets(friction={"static": static})
        assert node._meet((4e-4, 0.0, -1e-3)) == held
    # Beyond its cone it slides to it, and not further.
    sets(friction={"static": 0.2})
    slid = node._meet((4e-4, 0.0, -1e-3))[0][0]
    assert 0.0 < slid < 3e-4
    # Another radius carries the proxy along: pushed out to the new surface, not to the point
    # nearest to the device.
    sets(radius=0.0201, friction={"static": 1.5})
    carried = node._meet((4e-4, 0.0, -1e-3))[0]
    assert carried[0] == pytest.approx(slid, rel=0.01)
    assert math.dist(carried, (0.0, 0.0, -0.02)) == pytest.approx(
        0.0201 + TOOL_RADIUS, abs=1e-9
    )


def test_what_is_asked_again_is_not_answered_by_another_proxy() -> None:
    """Repeating a position changes nothing: a proxy is at rest after one call."""
    for kind, solid in SURFACES.items():
        path = wander(
            np.random.default_rng(4), 60, 2e-3, (0.01, 0.01, 0.004), (0.0, 0.0, 0.003)
        )
        once = led([solid._replace(friction=Friction(0.4, 0.2))], path)
        twice = led(
            [solid._replace(friction=Friction(0.4, 0.2))], np.repeat(path, 2, axis=0)
        )
        assert np.abs(twice.proxy[1::2] - twice.proxy[::2]).max() < 1e-12, kind
        assert np.abs(twice.proxy[::2] - once.proxy).max() < 1e-4, kind
