"""The proxy on shapes: closed forms, textbook distances and equilibrium, random scenes."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nodes.environment.shapes.mesh import prepare_mesh
from nodes.environment.shapes.scene import (
    Friction,
    Solid,
    box,
    capsule,
    cylinder,
    mesh,
    plane,
    sphere,
)
from nodes.environment.shapes.tables import INSIDE, SKIN
from sim.lab.proxy_shapes import icosphere, ideal_proxy
from sim.play.touch import Touched, touch
from tests.support import slowly
from tests.support.shapes import (
    Array,
    box_triangles,
    distance_to,
    out_of_balance,
    turned,
    wander,
)

# The first run on a machine compiles the geometry: some 25 s of one processor.

EXACT = 1e-12
"""Rounding of a few hundred operations on coordinates below 1 m, with a good margin [m]."""

RADIUS = 0.05


def led(solids: list[Solid], path: Array, tool: float = 0.0) -> Touched:
    """Move a device over shapes; short paths without the compiler, with equal bits."""
    return touch(solids, path, tool, interpreted=len(path) < 2500)


def around(
    depth: float, ticks: int = 400, speed: float = 0.2, period: float = 1e-3
) -> Array:
    """Enter a sphere of 50 mm and circle in it, in an oblique plane."""
    within = RADIUS - depth
    angle = np.arange(ticks) * speed * period / within
    ring = within * np.stack(
        [np.cos(angle), np.sin(angle) * math.cos(0.3), np.sin(angle) * math.sin(0.3)],
        axis=1,
    )
    return np.concatenate([np.linspace([RADIUS + 0.002, 0.0, 0.0], ring[0], 20), ring])


@pytest.mark.parametrize("tool", [0.0, 5e-4])
@pytest.mark.parametrize("depth", [1e-6, 4e-3, 0.045])
def test_on_a_sphere_it_is_the_radial_projection(depth: float, tool: float) -> None:
    found = led([sphere((0.0, 0.0, 0.0), RADIUS)], around(depth), tool)
    touching = found.path[found.contact]
    ideal = (
        (RADIUS + tool + SKIN)
        * touching
        / np.linalg.norm(touching, axis=1, keepdims=True)
    )
    assert np.abs(found.proxy[found.contact] - ideal).max() < EXACT
    assert found.contact[-400:].all()


@pytest.mark.parametrize("tool", [0.0, 5e-4])
def test_on_a_capsule_and_a_cylinder_it_is_the_nearest_point(tool: float) -> None:
    """All around and along both, away from the cylinder's ends."""
    rng = np.random.default_rng(3)
    angle, along = (
        np.cumsum(rng.normal(0.0, 0.01, 500)),
        np.clip(np.cumsum(rng.normal(0.0, 3e-4, 500)), -0.03, 0.03),
    )
    path = np.stack([along, 0.016 * np.cos(angle), 0.016 * np.sin(angle)], axis=1)
    path = np.concatenate([[[along[0], 0.03, 0.0]], path])
    radial = path[1:] * (0.0, 1.0, 1.0)
    ideal = path[1:] * (1.0, 0.0, 0.0) + (0.02 + tool + SKIN) * radial / np.linalg.norm(
        radial, axis=1, keepdims=True
    )
    for make in (capsule, cylinder):
        found = led([make((-0.04, 0.0, 0.0), (0.04, 0.0, 0.0), 0.02)], path, tool)
        assert np.abs(found.proxy[1:] - ideal).max() < EXACT
        assert found.contact[1:].all()


def test_an_oblique_plane_is_a_plane_across_an_axis_turned() -> None:
    path = wander(
        np.random.default_rng(1), 500, 1e-3, (0.01, 0.01, 0.01), (0.0, 0.0, 0.005)
    )
    normal = np.array((1.0, 2.0, 3.0)) / math.sqrt(14.0)
    found = led([plane((0.0, 0.0, 0.0), (1.0, 2.0, 3.0))], path)
    depth = np.minimum(path @ normal - SKIN, 0.0)
    assert np.abs(found.proxy - (path - depth[:, None] * normal)).max() < EXACT
    assert np.abs(found.distance - (path @ normal - SKIN)).max() < EXACT


def test_in_a_corner_of_three_planes_all_are_kept_in_one_call() -> None:
    """One step from free space into the corner, and along its edges."""
    walls = [
        plane((0.0, 0.0, 0.0), normal)
        for normal in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    ]
    path = np.array(
        [
            [0.01, 0.02, 0.03],
            [-0.01, -0.02, -0.03],
            [-0.01, 0.01, -0.01],
            [0.02, -0.01, -0.02],
            [0.02, 0.03, 0.01],
        ]
    )
    found = led(walls, path)
    assert np.abs(found.proxy - np.where(path > 0.0, path, SKIN)).max() < EXACT
    assert found.contact.tolist() == [False, True, True, True, False]


@pytest.mark.parametrize("opening", [0.05, 0.5, 1.5, 3.0])
def test_in_a_groove_it_rests_on_the_edge(opening: float) -> None:
    """Two planes that meet along y, from sharp to almost flat [rad]."""
    half = 0.5 * opening
    walls = [
        plane((0.0, 0.0, 0.0), (side * math.cos(half), 0.0, math.sin(half)))
        for side in (1.0, -1.0)
    ]
    path = np.array([[0.0, 0.0, 0.05], [0.0, 0.01, -0.002], [1e-5, -0.01, -0.002]])
    found = led(walls, path)
    edge = np.array([0.0, 0.0, SKIN / math.sin(half)])
    ideal = path * (0.0, 1.0, 0.0) + edge
    # Between two planes that are all but parallel, a gap of the tolerance moves the edge by that
    # over the sine.
    assert np.abs(found.proxy[1:] - ideal[1:]).max() < EXACT / math.sin(half)


def test_round_the_edge_of_a_box_and_back() -> None:
    """From its top, free beside it, then on the side: no jump between faces inside."""
    path = np.array(
        [
            [0.0, 0.0, 0.012],
            [0.0, 0.0, 0.008],
            [0.0099, 0.0, 0.008],
            [0.0101, 0.0, 0.008],
            [0.009, 0.0, 0.0],
            [0.009, 0.0, 0.0099],
        ]
    )
    found = led([box((0.0, 0.0, 0.0), (0.02, 0.02, 0.02))], path)
    over = 0.01 + SKIN
    ideal = [
        path[0],
        [0.0, 0.0, over],
        [0.0099, 0.0, over],
        path[3],
        [over, 0.0, 0.0],
        [over, 0.0, 0.0099],
    ]
    assert np.abs(found.proxy - ideal).max() < EXACT
    assert found.contact.tolist() == [False, True, True, False, True, True]


PLATE = (0.2, 0.2, 2e-4)
PLATES: dict[str, Solid] = {
    "box": box((0.0, 0.0, 0.0), PLATE),
    "mesh": mesh(prepare_mesh(box_triangles(PLATE), False, "plate")),
    "sheet": mesh(
        prepare_mesh(box_triangles(PLATE)[[10, 11]] * (1.0, 1.0, 0.0), True, "sheet")
    ),
}


@pytest.mark.parametrize("tool", [0.0, 5e-4])
@pytest.mark.parametrize("kind", PLATES)
def test_a_thin_plate_is_never_passed(kind: str, tool: float) -> None:
    """100 000 steps of up to 2 mm through a plate of 0.2 mm, and a sheet without thickness."""
    path = wander(
        np.random.default_rng(5), 100_000, 2e-3, (0.03, 0.03, 0.004), (0.0, 0.0, 0.002)
    )
    found = led([PLATES[kind]], path, tool)
    top = (0.0 if kind == "sheet" else 1e-4) + tool + SKIN
    assert 0.4 < found.contact.mean() < 0.6 + 50.0 * tool
    # It lies exactly over the device, on the plate or where the device is.
    assert np.abs(found.proxy[:, 2] - np.maximum(path[:, 2], top)).max() < EXACT
    assert np.abs(found.proxy[:, :2] - path[:, :2]).max() < EXACT


def scenes() -> dict[str, list[Solid]]:
    pebble = turned(icosphere(1, 0.012) * (1.0, 0.7, 0.5), 0.3, 0.5, 0.7)
    return {
        "sphere in a floor": [
            sphere((0.0, 0.0, 0.0), 0.01),
            plane((0.0, 0.0, 0.0), (0.1, 0.0, 1.0)),
        ],
        "box on a slope": [
            box((0.0, 0.0, 0.0), (0.01, 0.02, 0.015), (0.2, 0.3, 0.4)),
            plane((0.0, 0.0, -0.004), (0.3, 0.1, 1.0)),
        ],
        "crossing rods": [
            capsule((-0.02, 0.0, 0.0), (0.02, 0.0, 0.0), 0.004),
            cylinder((0.0, -0.02, 0.003), (0.0, 0.02, 0.0), 0.004),
        ],
        "pebble": [mesh(prepare_mesh(pebble, False, "pebble"))],
        "pebble on a box": [
            mesh(prepare_mesh(pebble, False, "pebble")),
            box((0.0, 0.0, -0.008), (0.03, 0.03, 0.01)),
        ],
        "hollow": [mesh(prepare_mesh(icosphere(2, 0.02)[:, ::-1], True, "hollow"))],
    }


SCENES = scenes()


@pytest.mark.parametrize("tool", slowly([0.0, 1e-3], but=[1e-3]))
@pytest.mark.parametrize("name", SCENES)
def test_at_rest_the_deflection_is_carried_by_what_is_touched(
    name: str, tool: float
) -> None:
    """Karush–Kuhn–Tucker with textbook distances and gradients, on a random path."""
    solids = SCENES[name]
    path = wander(
        np.random.default_rng(7),
        2000,
        2e-3,
        (0.015, 0.015, 0.015),
        (0.0, 0.0, 0.0145 if name != "hollow" else 0.0),
    )
    found = led(solids, path, tool)
    assert 0.1 < found.contact.mean() < 0.95
    assert np.array_equal(found.proxy[~found.contact], path[~found.contact])
    worst = 0.0
    for device, at in zip(path[::3], found.proxy[::3], strict=True):
        assert min(distance_to(solid, at) for solid in solids) >= tool - 1e-11
        worst = max(worst, out_of_balance(solids, tool, at, device))
    # Gradients by differences over 1 µm on curvatures of 1/4 mm: 1e-7 of a deflection of 10 mm.
    assert worst < 2e-8
    assert found.rounds.max() < 50


@settings(max_examples=25, derandomize=True)
@given(
    seed=st.integers(0, 2**32 - 1),
    tool=st.sampled_from([0.0, 2e-4, 2e-3]),
    friction=st.sampled_from(
        [Friction(), Friction(0.5, 0.3), Friction(0.2, 0.2, 0.01)]
    ),
)
def test_compiled_and_interpreted_give_the_same_bits(
    seed: int, tool: float, friction: Friction
) -> None:
    rng = np.random.default_rng(seed)
    solids = [
        solid._replace(friction=friction)
        for solid in SCENES[str(rng.choice(list(SCENES)))]
    ]
    path = wander(rng, 40, 4e-3, (0.015, 0.015, 0.015), rng.uniform(-0.015, 0.015, 3))
    plain, fast = (
        touch(solids, path, tool, interpreted=interpreted)
        for interpreted in (True, False)
    )
    for one, other in zip(plain, fast, strict=True):
        assert np.array_equal(np.asarray(one), np.asarray(other))


@pytest.mark.parametrize("tool", [0.0, 1e-3])
def test_a_frictionless_loop_has_no_drag(tool: float) -> None:
    """There and back in a mesh of 20 480 triangles, 4 mm deep: no energy lost, to 1e-6."""
    faces = mesh(
        prepare_mesh(turned(icosphere(5, RADIUS), 0.1, 0.2, 0.3), False, "ball")
    )
    there = around(4e-3, 3000)[20:]
    path = np.concatenate([around(4e-3, 1)[:20], there, there[::-1]])
    found = led([faces], path, tool)
    force = (found.proxy - path)[20:]
    step = np.diff(path[20:], axis=0)
    work = np.einsum("ij,ij->", 0.5 * (force[1:] + force[:-1]), step)
    pushed = np.linalg.norm(force, axis=1)[1:] @ np.linalg.norm(step, axis=1)
    assert abs(work) / pushed < 1e-6
    # The same places, the same proxies.
    assert np.abs(found.proxy[20:] - found.proxy[20:][::-1]).max() < 1e-9


@pytest.mark.parametrize(
    "friction", [Friction(), Friction(0.3, 0.2)], ids=["slippery", "rough"]
)
@pytest.mark.parametrize("name", SCENES)
def test_a_closed_way_gives_out_no_energy_but_by_sampling(
    name: str, friction: Friction
) -> None:
    """A closed path from outside through a scene, with 1 N/m between device and proxy.

    Within a tick the force changes between two values: the sum of their means is right to half of
    each change over the step. A scene that gives out more makes energy; one whose proxy jumps at an
    edge loses some.
    """
    solids = [solid._replace(friction=friction) for solid in SCENES[name]]
    rng = np.random.default_rng(7)
    turn = np.linspace(0.0, 2.0 * np.pi, 3000)
    for _ in range(6):
        speeds, phases = rng.integers(1, 4, 3), rng.uniform(0.0, 2.0 * np.pi, 3)
        path = 0.012 * np.sin(speeds * turn[:, None] + phases)
        # In and out along one line, from well outside of everything.
        way_in = np.linspace([0.0, 0.0, 0.06], path[0], 500)
        path = np.concatenate([way_in, path, way_in[::-1]])
        found = led(solids, path)
        stretch = np.where(found.contact[:, None], found.proxy - path, 0.0)
        assert not stretch[0].any()
        step = np.diff(path, axis=0)
        given_out = float(
            np.einsum("ij,ij->", 0.5 * (stretch[1:] + stretch[:-1]), step)
        )
        unknown = 0.5 * float(
            np.linalg.norm(np.diff(stretch, axis=0), axis=1)
            @ np.linalg.norm(step, axis=1)
        )
        # Rough rods may hold the proxy on their far side: then some of the energy is still in the
        # spring.
        stored = 0.5 * float(stretch[-1] @ stretch[-1])
        assert given_out + stored <= unknown
        if friction.static and found.contact.mean() > 0.2:
            assert given_out < 0.0


def test_on_a_mesh_it_is_the_nearest_point_of_the_mesh() -> None:
    """In a convex body and at shallow edges, god object and nearest point (libigl) agree."""
    igl = pytest.importorskip("igl")
    triangles = turned(icosphere(5, RADIUS), 0.1, 0.2, 0.3)
    path = around(4e-3, 3000)
    corners = triangles.reshape(-1, 3)
    nearest: Any = igl.point_mesh_squared_distance(
        path, corners, np.arange(len(corners)).reshape(-1, 3)
    )[2]
    for tool in (0.0, 5e-4):
        found = led([mesh(prepare_mesh(triangles, False, "ball"))], path, tool)
        inside = found.contact & (np.linalg.norm(path, axis=1) < RADIUS - 1e-4)
        outward = (nearest - path)[inside]
        ideal = nearest[inside] + (tool + SKIN) * outward / np.linalg.norm(
            outward, axis=1, keepdims=True
        )
        assert np.abs(found.proxy[inside] - ideal).max() < EXACT
        assert inside.sum() > 2900


ROLLS = "test_a_ball_that_is_larger_than_the_triangles_comes_to_rest_in_few_rounds"


@pytest.mark.parametrize(
    ("halvings", "tool"),
    [(4, 2e-3), (5, 1e-3), pytest.param(6, 1e-3, marks=pytest.mark.thorough(ROLLS))],
)
def test_a_ball_that_is_larger_than_the_triangles_comes_to_rest_in_few_rounds(
    halvings: int, tool: float
) -> None:
    """It rolls over corners and edges closer together than its size.

    It is held by the rounded polyhedron, whose nearest point is known by brute force over all
    triangles.
    """
    triangles = turned(icosphere(halvings, 0.035), 0.1, 0.2, 0.3)
    # 0.23 mm a tick, as in a launch, at depths up to 0.7 of the tool's radius.
    angle = 0.23e-3 / 0.035 * np.arange(600)
    deep = tool * (0.35 - 0.35 * np.cos(7.0 * angle))
    ring = np.stack(
        [np.cos(angle), np.sin(angle) * math.cos(0.3), np.sin(angle) * math.sin(0.3)],
        axis=1,
    )
    found = led(
        [mesh(prepare_mesh(triangles, False, "ball"))],
        (0.035 + tool - deep)[:, None] * ring,
        tool,
    )
    assert found.contact.mean() > 0.9
    worst = 0.0
    for k in np.flatnonzero(found.contact)[::6]:
        # It is within the tool's radius, on a triangle with edges below 3 mm: no other needs to be
        # looked at.
        near = triangles[
            np.linalg.norm(triangles[:, 0] - found.path[k], axis=1) < tool + 3e-3
        ]
        ideal = ideal_proxy(near, found.path[k], tool, inside=False)
        worst = max(worst, float(np.linalg.norm(found.proxy[k] - ideal)))
    assert worst < EXACT
    assert found.rounds.max() < 100


def test_the_distance_from_outside_is_that_of_the_textbook() -> None:
    rng = np.random.default_rng(11)
    for solids in SCENES.values():
        for tool in (0.0, 1e-3):
            path = rng.uniform(-0.04, 0.04, (40, 3))
            path = path[
                [
                    min(distance_to(solid, point) for solid in solids) > tool + 1e-6
                    for point in path
                ]
            ]
            for point in path:
                # Each from free space, as a new proxy.
                found = led(solids, point[None], tool)
                distance = min(distance_to(solid, point) for solid in solids)
                if not found.contact[0] and not found.memory[INSIDE]:
                    assert found.distance[0] == pytest.approx(
                        distance - tool - SKIN, abs=EXACT
                    )
                    nearer = point - 1e-7 * found.normal[0]
                    assert min(
                        distance_to(solid, nearer) for solid in solids
                    ) == pytest.approx(distance - 1e-7, abs=1e-11)


def test_a_position_beyond_all_reason_leaves_no_trace() -> None:
    """Squares of 1e300 overflow; afterwards the proxy starts as on the first tick."""
    for solids in SCENES.values():
        wild = np.array(
            [
                [0.0, 0.0, 0.03],
                [1e300, -1e300, 1e300],
                [0.0, 1e4, 0.0],
                [0.0, 0.0, 0.03],
                [0.0, 0.0, 0.001],
            ]
        )
        found, calm = led(solids, wild), led(solids, wild[3:])
        assert np.array_equal(found.proxy[3:], calm.proxy)
        assert np.array_equal(
            found.proxy[:3],
            np.where(found.contact[:3, None], found.proxy[:3], wild[:3]),
        )
        assert not found.contact[1:3].any()
        assert np.isfinite(found.distance).all()


@pytest.mark.parametrize("depth", [4e-4, 6e-4])
def test_a_device_that_begins_deep_inside_feels_a_solid_once_it_is_outside(
    depth: float,
) -> None:
    """Up to 0.5 mm deep it starts on the surface; deeper it is free until outside."""
    for solid in (
        box((0.0, 0.0, 0.0), (0.02, 0.02, 0.02)),
        mesh(prepare_mesh(box_triangles((0.02, 0.02, 0.02)), False, "box")),
    ):
        within = 0.01 - depth
        path = np.array(
            [
                [0.0, within, 0.0],
                [0.0, 0.0, within],
                [0.0, 0.0, 0.0115],
                [0.0, 0.0, 0.009],
            ]
        )
        found = led([solid], path, 1e-3)
        assert list(found.contact) == [depth < 5e-4, depth < 5e-4, False, True]
        if depth < 5e-4:
            assert found.proxy[0, 1] == pytest.approx(0.011 + SKIN, abs=EXACT)
        else:
            assert np.array_equal(found.proxy[:3], path[:3])
        assert found.proxy[3, 2] == pytest.approx(0.011 + SKIN, abs=EXACT)


def test_a_half_space_pushes_a_device_out_that_begins_behind_it() -> None:
    found = led(
        [plane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))], np.array([[0.0, 0.0, -0.02]])
    )
    assert found.proxy[0, 2] == pytest.approx(SKIN, abs=EXACT)
