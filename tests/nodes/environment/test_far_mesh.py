"""A far mesh in free air: its distance, and that finding it costs no more than contact."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from nodes.environment.shapes.mesh import prepare_mesh
from nodes.environment.shapes.proxy import meet
from nodes.environment.shapes.scene import mesh, new_memory, scene_table
from nodes.environment.shapes.tables import (
    DISTANCE,
    FAR_ERROR,
    IN_CONTACT,
    INSIDE,
    NEAR,
    NORMAL,
    SKIN,
)
from sim.lab.proxy_shapes import icosphere, ring
from tests.support.shapes import Array, squared_distance

EXACT = 1e-12  # rounding of a few hundred operations on coordinates below 1 m [m]
TICKS = 24


class Counted(list[float]):
    """A scene table that counts how often it is read: the work of a call, on any machine."""

    reads = 0

    def __getitem__(self, place: Any) -> Any:
        """Return a number, and count."""
        self.reads += 1
        return super().__getitem__(place)


def torus(around: int, across: int, radius: float, tube: float) -> Array:
    """Return the triangles of a torus about the z axis, shape (n, 3, 3)."""
    u = 2.0 * np.pi * np.arange(around)[:, None] / around
    v = 2.0 * np.pi * np.arange(across) / across
    out = radius + tube * np.cos(v)
    a = np.stack(
        [out * np.cos(u), out * np.sin(u), tube * np.sin(v) + 0.0 * u], axis=-1
    )
    b = np.roll(a, -1, axis=0)
    c, d = np.roll(b, -1, axis=1), np.roll(a, -1, axis=1)
    pairs = [np.stack([a, b, c], axis=-2), np.stack([a, c, d], axis=-2)]
    return np.concatenate([pair.reshape(-1, 3, 3) for pair in pairs])


def played(
    corners: Array, path: Array, sheet: bool = False, radius: float = 0.0
) -> tuple[Array, Array, Array]:
    """Return answers of distance, normal, contact and inside; tables' reads; true distances."""
    made = prepare_mesh(corners, sheet, "file")
    table = Counted(scene_table([mesh(made)], radius, 1e-3))
    memory = new_memory(1)
    answers, reads = [], []
    for place in path.tolist():
        table.reads = 0
        meet(table, memory, *place)
        reads.append(table.reads)
        answers.append(
            (memory[DISTANCE], *memory[NORMAL : NORMAL + 3], memory[IN_CONTACT])
        )
        assert memory[INSIDE] == 0.0
    squared = squared_distance(made.corners, path)
    # The first tick has no nearest triangle of a tick before.
    return np.array(answers), np.array(reads[1:]), np.sqrt(squared)


BALL = icosphere(4, 0.05)
HOLLOW = np.concatenate([BALL, icosphere(4, 0.04)[:, ::-1]])
TORUS = torus(200, 20, 0.05, 0.015)
ON_BALL, OUTWARD = ring(TICKS, 0.2, 1e-3, 0.05)
TURN = np.arange(TICKS)[:, None] * [0.02, 0.03, 0.05]
PATHS = [
    (BALL, ON_BALL + 1e-3 * OUTWARD),
    (BALL, ON_BALL + 0.03 * OUTWARD),
    (BALL, ON_BALL + 0.1 * OUTWARD),
    (TORUS, np.sin(TURN) * [1e-5, 1e-5, 0.01]),
    (TORUS, np.sin(TURN) * [1e-5, 1e-5, 0.01] + [0.01, 0.0, 0.0]),
    (HOLLOW, 1e-3 * np.sin(TURN)),
    (HOLLOW, np.linspace([-2e-3, 0.0, 0.0], [4e-3, 1e-3, 0.0], 60)),
]
NAMES = [
    "1 mm above",
    "30 mm above",
    "100 mm above",
    "axis",
    "beside it",
    "middle",
    "through it at 0.1 m/s",
]


@pytest.mark.parametrize(("corners", "path"), PATHS, ids=NAMES)
def test_a_far_mesh_costs_no_more_than_contact(corners: Array, path: Array) -> None:
    """The distance is libigl's nearby, beyond within its limit, in the time of contact.

    It is that of a place of the mesh, which plots draw as the surface.
    """
    below = 4e-3 * np.minimum(np.arange(TICKS) / 10.0, 1.0) - 1e-4
    outer = np.array([1.0, 0.0, 0.0]) if corners is TORUS else OUTWARD
    start = 0.065 * outer if corners is TORUS else ON_BALL
    pressed = start - below[:, None] * outer
    if corners is TORUS:
        angle = TURN[:, 0] / 10.0
        pressed = pressed[:, :1] * np.column_stack(
            [np.cos(angle), np.sin(angle), 0.0 * angle]
        )
    held, pressing, _ = played(corners, pressed)
    assert held[10:, 4].all()
    found, reads, true = played(corners, path)
    # In the middle of a hollow ball all triangles are equally far, and boxes of oblique parts
    # bound them loosely: a search takes 20 times as much, and then holds for 1.6 mm.
    if corners is HOLLOW:
        assert reads.mean() <= 1.1 * pressing.mean()
    assert reads.max() <= pressing.max() * (20 if len(path) > TICKS else 1)
    drawn = path - found[:, :1] * found[:, 1:4]
    off = squared_distance(corners, drawn)
    assert np.sqrt(off).max() < SKIN + EXACT
    away = found[:, 0] + SKIN
    assert not found[:, 4].any()
    assert np.abs(np.linalg.norm(found[:, 1:4], axis=1) - 1.0).max() < EXACT
    assert (away > true - EXACT).all()
    assert (away < true * (1.0 + FAR_ERROR) + EXACT).all()


def tiles() -> Array:
    """Return a flat sheet of 800 triangles, 20 mm wide, shape (800, 3, 3)."""
    x, y = np.meshgrid(np.arange(20), np.arange(20), indexing="ij")
    corner = 1e-3 * np.stack([x, y, 0.0 * x], axis=-1).reshape(-1, 1, 3)
    halves = np.array(
        [[[0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 0, 0], [1, 1, 0], [0, 1, 0]]]
    )
    return np.concatenate([corner + 1e-3 * half for half in halves])


def test_a_mesh_has_its_exact_distance_up_to_the_limit() -> None:
    """Along a flat sheet, whose boxes are as near as their triangles; far above it is not."""
    way = np.linspace([2.3e-3, 5e-3, 0.0], [7.1e-3, 6.4e-3, 0.0], TICKS)
    for height in (0.98 * NEAR, 8.0 * NEAR):
        found, _, true = played(tiles(), way + height * np.eye(3)[2], sheet=True)
        assert (np.abs(found[:, 0] + SKIN - true).max() < EXACT) == (height < NEAR)


def test_a_tool_in_the_middle_of_a_solid_waits_at_low_cost() -> None:
    """Until it is outside, it is asked each tick: by a ray, not by the nearest triangle."""
    made = prepare_mesh(BALL, False, "file")
    table = Counted(scene_table([mesh(made)], 0.0, 1e-3))
    memory = new_memory(1)
    for k, place in enumerate((1e-3 * np.sin(TURN)).tolist()):
        table.reads = 0
        meet(table, memory, *place)
        assert memory[INSIDE] == 1.0
        assert k == 0 or table.reads < 1000


def test_a_large_tool_errs_by_that_part_of_its_own_distance() -> None:
    """Not of that of its centre, which lies a radius farther."""
    radius = 20.0 * NEAR
    way = np.linspace([2.3e-3, 5e-3, 0.0], [17.1e-3, 6.4e-3, 0.0], TICKS)
    up = (1.2 * NEAR + radius) * np.eye(3)[2]
    found, _, true = played(tiles(), way + up, True, radius)
    away = found[:, 0] + SKIN
    assert (away > true - radius - EXACT).all()
    assert (away < (true - radius) * (1.0 + FAR_ERROR) + EXACT).all()
