"""Rules that hold for every registered shape; a new one needs an example here."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from nodes.environment.shapes import tables as t
from nodes.environment.shapes.convex import gap
from nodes.environment.shapes.scene import scene_table
from nodes.environment.shapes.touchable import Shape
from nodes.environment.surfaces import SURFACES, parse_surface
from nodes.view.shape import patches_of
from nodes.view.tessellation import ACROSS, AROUND
from sim.lab.proxy_shapes import nearest_on

RADIUS = 0.01
EXAMPLES: dict[str, dict[str, Any]] = {
    "oriented_plane": {"position": [0.0, 0.01, 0.0], "normal": [0.1, 0.2, 1.0]},
    "sphere": {"position": [0.0, 0.002, 0.0], "radius": RADIUS},
    "box": {
        "position": [0.0, 0.0, 0.001],
        "size": [0.02, 0.016, 0.012],
        "rotation": [0.3, 0.2, 1],
    },
    "capsule": {
        "start": [-0.01, 0.0, 0.0],
        "end": [0.012, 0.004, 0.0],
        "radius": RADIUS,
    },
    "cylinder": {
        "start": [-0.01, 0.0, 0.0],
        "end": [0.012, 0.004, 0.0],
        "radius": RADIUS,
    },
}
OF_TRIANGLES = {
    "mesh"
}  # no distance of its own: tests/nodes/environment/test_meshes.py
POINTS = np.random.default_rng(5).uniform(-0.025, 0.025, (60, 3))
# The drawing is a polyhedron within round parts: its greatest distance below the surface [m].
SAGITTA = RADIUS * (1.0 - np.cos(np.pi / AROUND) * np.cos(0.5 * np.pi / ACROSS))


def distance(kind: str, point: Any) -> tuple[float, Any]:
    """Return the signed distance [m] and the normal that a point of no radius meets."""
    surface = parse_surface({"kind": kind, **EXAMPLES[kind]}, "surface")
    assert isinstance(surface, Shape)
    scene = scene_table(surface.solids("surface"), 0.0, 1e-3)
    away, *normal = gap(scene, t.ROWS, *map(float, point))
    return away + t.SKIN, np.array(normal)


def test_every_registered_shape_has_an_example() -> None:
    shapes = {
        name for name in SURFACES.names() if issubclass(SURFACES.load(name), Shape)
    }
    assert shapes == EXAMPLES.keys() | OF_TRIANGLES


@pytest.mark.parametrize("kind", EXAMPLES)
def test_a_shape_is_drawn_where_it_is_felt(kind: str) -> None:
    (patch,) = patches_of({"surface": {"kind": kind, **EXAMPLES[kind]}})
    for point in POINTS:
        away, _ = distance(kind, point)
        seen = np.linalg.norm(point - nearest_on(patch.corners, point), axis=1).min()
        # 1e-12: rounding of lengths below 0.1 m
        assert abs(abs(away) - seen) <= SAGITTA + 1e-12


@pytest.mark.parametrize("kind", EXAMPLES)
def test_the_normal_is_the_gradient_of_the_distance(kind: str) -> None:
    step = 1e-6  # central differences: error step² / radius², 1e-8; rounding 1e-16 / step, 1e-10
    for point in POINTS:
        away, normal = distance(kind, point)
        sides = [
            (
                distance(kind, point + step * axis)[0]
                - distance(kind, point - step * axis)[0]
            )
            / (2.0 * step)
            for axis in np.eye(3)
        ]
        assert abs(np.linalg.norm(normal) - 1.0) < 1e-12
        if away > 0.0:  # inside, the nearest face may change within the step
            assert np.abs(np.array(sides) - normal).max() < 1e-6
