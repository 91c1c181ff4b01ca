"""Drawn shapes lie on the surfaces of the geometry."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from nodes.view.shape import shape_of

Corners = NDArray[np.float64]

CUBE = """v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 1\nv 1 0 1\nv 1 1 1\nv 0 1 1
f 1 4 3 2\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n"""


def ball(p: Corners) -> Corners:
    return np.asarray(np.linalg.norm(p - [0.05, 0.01, -0.03], axis=1) - 0.035)


def turned_box(p: Corners) -> Corners:
    """Return a box rotated by 90° of yaw: first edge along y, second along −x."""
    local = (p - [0.01, 0.0, 0.0]) @ np.array(
        [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    )
    return np.asarray(np.abs(np.abs(local) - [0.01, 0.02, 0.03]).max(axis=1))


def rod(p: Corners) -> Corners:
    """Return the distance to a capsule of radius 10 mm along x, from 0 to 50 mm."""
    return np.asarray(
        np.linalg.norm(
            p - np.stack([np.clip(p[:, 0], 0.0, 0.05), 0 * p[:, 0], 0 * p[:, 0]], 1),
            axis=1,
        )
        - 0.01
    )


def can(p: Corners) -> Corners:
    """Return the distance to a cylinder of radius 10 mm along z, from 0 to 40 mm."""
    out, end = (
        np.hypot(p[:, 0], p[:, 1]),
        np.minimum(np.abs(p[:, 2]), np.abs(p[:, 2] - 0.04)),
    )
    return np.asarray(np.where(out < 0.005, end, np.maximum(np.abs(out - 0.01), end)))


@pytest.mark.parametrize(
    ("surface", "off"),
    [
        ({"kind": "sphere", "position": [0.05, 0.01, -0.03], "radius": 0.035}, ball),
        (
            {
                "kind": "box",
                "position": [0.01, 0.0, 0.0],
                "size": [0.02, 0.04, 0.06],
                "rotation": [0.0, 0.0, math.pi / 2],
            },
            turned_box,
        ),
        (
            {
                "kind": "capsule",
                "start": [0.0, 0.0, 0.0],
                "end": [0.05, 0.0, 0.0],
                "radius": 0.01,
            },
            rod,
        ),
        (
            {
                "kind": "cylinder",
                "start": [0.0, 0.0, 0.0],
                "end": [0.0, 0.0, 0.04],
                "radius": 0.01,
            },
            can,
        ),
        (
            {
                "kind": "oriented_plane",
                "position": [0.0, 0.01, 0.0],
                "normal": [0.0, 1.0, 1.0],
            },
            lambda p: p[:, 1] + p[:, 2] - 0.01,
        ),
        (
            {"kind": "mesh", "file": "cube.obj", "scale": 0.02},
            lambda p: np.minimum(np.abs(p), np.abs(p - 0.02)).max(1),
        ),
    ],
)
def test_every_corner_of_every_kind_lies_on_its_surface(
    surface: dict[str, Any], off: Any, tmp_path: Path
) -> None:
    if "file" in surface:
        (tmp_path / "cube.obj").write_text(CUBE, encoding="utf-8")
        surface = {**surface, "file": str(tmp_path / "cube.obj")}
    corners = np.array(shape_of({"surface": surface})["triangles"]).reshape(-1, 3)
    assert len(np.unique(corners, axis=0)) >= 8
    # Corners are rounded to a micrometre.
    assert np.abs(off(corners)).max() < 2e-6


def test_a_flat_wall_is_a_patch_and_nothing_is_nothing() -> None:
    patch = np.array(
        shape_of({"surface": {"kind": "plane", "axis": "x", "position": 0.02}})[
            "triangles"
        ]
    ).reshape(-1, 3)
    assert np.all(patch[:, 0] == 0.02)
    assert np.ptp(patch[:, 1]) == pytest.approx(0.16)
    assert shape_of({"surface": {"kind": "free"}}) == {}
