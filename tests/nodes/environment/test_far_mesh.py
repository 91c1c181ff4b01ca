"""The nearest triangle of a far mesh: exact, and found by few triangles."""

from __future__ import annotations

from typing import Any

import igl
import numpy as np
import pytest

from nodes.environment.shapes import tree
from nodes.environment.shapes.mesh import prepare_mesh
from nodes.environment.shapes.scene import mesh, new_memory, scene_table
from nodes.environment.shapes.tables import LAST, ROWS, SKIN
from nodes.environment.shapes.tree import mesh_gap
from nodes.environment.shapes.triangle import nearest_on_triangle
from sim.lab.proxy_shapes import icosphere, ring

EXACT = 1e-12  # rounding of a few hundred operations on coordinates below 1 m [m]


def test_a_far_mesh_is_found_exactly_by_few_triangles(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """From 1 to 100 mm above a ball of 20 480: libigl's distance, in the time of contact."""
    made = prepare_mesh(icosphere(5, 0.05), False, "file")
    corners = np.ascontiguousarray(made.corners.reshape(-1, 3))
    ids = np.arange(len(corners)).reshape(-1, 3)
    table, memory = scene_table([mesh(made)], 0.0, 1e-3), new_memory(1)
    asked: list[int] = []

    def count(scene: Any, at: int, x: float, y: float, z: float) -> Any:
        asked.append(at)
        return nearest_on_triangle(scene, at, x, y, z)

    monkeypatch.setattr(tree, "nearest_on_triangle", count)
    on_ball, outward = ring(12, 0.2, 1e-3, 0.05)
    for height in (1e-3, 0.03, 0.1):
        path = on_ball + height * outward
        squared: Any = igl.point_mesh_squared_distance(path, corners, ids)[0]
        before, found = 0, []
        for k, place in enumerate(path.tolist()):
            found.append(mesh_gap(table, ROWS, memory, LAST, *place)[0])
            before = len(asked) if k == 0 else before
        assert np.abs(np.array(found) + SKIN - np.sqrt(squared)).max() < EXACT
        # More than twice as many have a box within the distance of the nearest one.
        assert len(asked) - before < 20 * len(path)
        asked.clear()
