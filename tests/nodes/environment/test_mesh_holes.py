"""Holes of a mesh: which are filled, and which on request, around each limit."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from nodes.environment.shapes.mesh import prepare_mesh
from nodes.environment.shapes.mesh_file import MOST_EDGES, MOST_WIDTH
from nodes.environment.shapes.mesh_holes import breadth, lid
from nodes.environment.shapes.mesh_repair import NARROW, Repaired, repair
from nodes.environment.shapes.touchable import TOOL_RADIUS
from nodes.parameters.store import ParameterError
from sim.lab.proxy_shapes import icosphere
from tests.support.shapes import Array, box_triangles, winding

SIDE = 0.02
CUBE = box_triangles((SIDE, SIDE, SIDE))
BALL = icosphere(3, 0.04)
PLACES = np.random.default_rng(5).uniform(-0.05, 0.05, (300, 3))


def cracked(deep: float) -> Array:
    """Return a cube with a crack along the edge of one triangle, `deep` at its middle [m]."""
    a, b, c = CUBE[0]
    inward = np.cross(np.cross(b - a, c - a), b - a)
    middle = 0.5 * (a + b) + deep * inward / np.linalg.norm(inward)
    return np.concatenate([CUBE[1:], [[a, middle, c], [middle, b, c]]])


def closed(corners: Array) -> Repaired:
    """Repair triangles, with small holes filled."""
    return repair(corners, widest=MOST_EDGES, part=MOST_WIDTH)


def enclosed(found: Repaired, solid: Array, room: float) -> None:
    """Check that a repaired mesh encloses the places that a closed one does."""
    corners = found.points[found.ids]
    assert found.is_solid
    assert np.abs(winding(corners, PLACES) - winding(solid, PLACES)).max() < room


def test_a_crack_without_room_for_the_tool_is_no_hole() -> None:
    """One broader than the default tool is, and the mesh is open then."""
    assert NARROW == 2.0 * TOOL_RADIUS
    made = prepare_mesh(cracked(0.95 * NARROW), False, "file")
    assert made.repairs == ("file: 1 holes filled that are narrower than 2e-05 m",)
    found = repair(cracked(0.95 * NARROW))
    enclosed(found, CUBE, 1e-3)
    with pytest.raises(ParameterError, match="the mesh is open: 3 edges"):
        prepare_mesh(cracked(1.05 * NARROW), False, "file")


def test_a_sheet_with_a_crack_keeps_it() -> None:
    """Narrow holes are filled only where that closes the mesh."""
    found = repair(cracked(0.95 * NARROW)[1:])
    assert not found.is_solid
    assert not found.counts["narrow"]


def test_a_long_slit_is_a_small_hole() -> None:
    """What counts is the largest disc in it, not its length."""
    limit = MOST_WIDTH * SIDE
    enclosed(closed(cracked(0.9 * limit)), CUBE, 0.1)
    assert not closed(cracked(1.5 * limit)).is_solid


def test_holes_that_meet_at_a_corner_are_filled() -> None:
    """Their rim passes that corner twice: each loop of it has a lid of its own."""
    hub = BALL[0, 0]
    around = np.flatnonzero((hub == BALL).all(axis=2).any(axis=1))
    one = BALL[around[0]]
    far = [k for k in around if len({*map(tuple, BALL[k])} & {*map(tuple, one)}) == 1]
    found = closed(np.delete(BALL, [around[0], far[0]], axis=0))
    enclosed(found, BALL, 1e-9)
    assert found.counts["holes"] == 2


def test_a_loose_piece_of_a_sheet_is_left_out_on_request() -> None:
    """A small one beside a solid; one that is most of the mesh stays a sheet."""
    flap = 0.05 * CUBE[:1] + 0.03
    found = closed(np.concatenate([CUBE, flap]))
    enclosed(found, CUBE, 1e-9)
    assert found.counts["pieces"] == 1
    assert found.texts() == ["1 small loose pieces of sheets left out"]
    assert not repair(np.concatenate([CUBE, flap])).is_solid
    flat = np.array([[[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]]) * [0.05, 0.001, 1.0]
    assert not closed(flat).is_solid


@pytest.mark.parametrize(
    ("rim", "expected"),
    [
        ([[0, 0], [3, 0], [0, 4]], 2.0),
        ([[0, 0], [7, 0], [7, 2], [0, 2]], 2.0),
        ([[0, 0], [40, 0], [20, 1e-3]], 1e-3),
        ([[np.cos(a), np.sin(a)] for a in np.arange(24) * np.pi / 12.0], 2.0),
    ],
    ids=["triangle", "rectangle", "sliver", "round"],
)
def test_the_breadth_of_a_hole_is_that_of_its_largest_disc(
    rim: list[list[float]], expected: float
) -> None:
    """By closed forms, within the spacing of the places that are asked."""
    outline = np.column_stack([np.array(rim), np.zeros(len(rim))])
    found = breadth(outline, lid(outline))
    assert expected * 0.9 < found < expected * 1.0001


def test_what_is_closed_is_closed_when_it_is_read_again() -> None:
    """The copy that `--close` writes is a solid: it keeps no face that reading leaves out."""
    rng = np.random.default_rng(11)
    for _ in range(6):
        left = np.delete(BALL, rng.choice(len(BALL), 40, replace=False), axis=0)
        found = closed(np.concatenate([left, left[:3, ::-1] * 1.0]))
        again = repair(found.points[found.ids])
        assert found.is_solid
        assert again.is_solid
        enclosed(again, BALL, 0.05)


def test_a_long_crack_costs_a_step_for_each_edge() -> None:
    """Not one for each pair of its corners: cracks are closed at each start, unasked."""

    def calls(count: int) -> int:
        angle = 2.0 * np.pi * np.arange(count) / count
        rim = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
        events: list[str] = []
        before = sys.getprofile()
        sys.setprofile(lambda _frame, event, _what: events.append(event))
        try:
            lid(rim)
        finally:
            sys.setprofile(before)
        return events.count("c_call")

    assert calls(80) < 2.5 * calls(40)
