"""Closed meshes with parts that are inside out: found, and refused as solids."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nodes.cli.main import main
from nodes.environment.shapes.mesh import prepare_mesh
from nodes.environment.shapes.mesh_lobes import inside_out
from nodes.environment.shapes.mesh_report import write_mesh
from nodes.parameters.store import ParameterError
from tests.support.shapes import Array, box_triangles, crossing_prism, turned, winding

BOX = box_triangles([0.02] * 3)
# One of its two lobes is inside out.
BOW = crossing_prism(
    np.array([[0.0, 0.0], [0.03, 0.02], [0.03, 0.0], [0.0, 0.008], [-0.01, 0.004]]),
    0.02,
)
ANGLE = crossing_prism(
    1e-3 * np.array([[-10, -10], [20, -10], [20, 5], [5, 5], [5, 20], [-10, 20]]), 0.02
)


def poking(out: float) -> Array:
    """Return a solid with a notch, and a cavity that pokes into the notch by `out` [m]."""
    cavity = box_triangles([6e-3, 8e-3, 1e-2])[:, ::-1]
    return np.concatenate([ANGLE, cavity + np.array([2e-3 + out, 12e-3, 10e-3])])


HOLLOW = np.concatenate([BOX, 0.5 * BOX[:, ::-1]])
OVERLAPPING = np.concatenate([BOX, BOX + np.array([0.015, 0.004, 0.0])])
FLUSH = np.concatenate([BOX, 0.5 * BOX[:, ::-1] + np.array([0.005, 0.0, 0.0])])


@pytest.mark.parametrize("corners", [BOX, HOLLOW, OVERLAPPING, FLUSH])
def test_shells_and_cavities_are_not_inside_out(corners: Array) -> None:
    """Cavities, overlaps and a cavity that ends flush with the outside."""
    assert inside_out(corners) is None
    lobe = inside_out(corners[:, ::-1])
    assert lobe is not None  # the other way round they are
    assert winding(corners[:, ::-1], np.array([lobe.place]))[0] < -0.5


@pytest.mark.parametrize(
    ("corners", "length"),
    # The widest chords along an axis: across the lobe, and along the cavity.
    [(BOW, 0.0214), (poking(1e-3), 0.01)],
    ids=["bow", "poking"],
)
def test_a_part_that_is_inside_out_is_refused_as_a_solid(
    corners: Array, length: float
) -> None:
    """It takes a tool in without a force, and holds it inside."""
    with pytest.raises(ParameterError, match="inside out") as refused:
        prepare_mesh(corners, False, "environment.surface.file")
    assert refused.value.path == "environment.surface.file"
    assert "sides: both" in refused.value.text
    assert not prepare_mesh(corners, True, "file").closed
    lobe = inside_out(corners)
    assert lobe is not None
    assert lobe.length == pytest.approx(length, rel=0.02)  # lines stand a 64th apart


def test_a_part_too_thin_for_the_tool_is_no_reason_to_refuse() -> None:
    """A cavity pokes out by less than the default tool's diameter, and by more."""
    thin, thick = poking(1.5e-5), poking(3e-5)
    lobe = inside_out(thin)
    assert lobe is not None
    assert lobe.length == pytest.approx(1.5e-5, rel=1e-6)
    assert prepare_mesh(thin, False, "file").closed
    with pytest.raises(ParameterError, match="inside out"):
        prepare_mesh(thick, False, "file")


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_inside_out_is_where_the_winding_number_is_negative(seed: int) -> None:
    """Boxes and bows at random places, some inside out: libigl's winding number decides."""
    rng = np.random.default_rng(seed)
    parts = []
    for _ in range(int(rng.integers(1, 5))):
        made = BOW if rng.integers(0, 2) else box_triangles(rng.uniform(0.005, 0.02, 3))
        made = turned(made, *rng.uniform(-3.0, 3.0, 3).tolist())
        made = made + rng.uniform(-0.012, 0.012, 3)
        parts.append(made[:, ::-1] if rng.integers(0, 3) == 0 else made)
    corners = np.concatenate(parts)
    lobe = inside_out(corners)
    places = corners.reshape(-1, 3)
    tried = rng.uniform(places.min(axis=0), places.max(axis=0), (400, 3))
    if lobe is None:
        # A part of more than one in 64³ of the box may be missed, one of a hundredth not.
        assert (winding(corners, tried) < -0.5).mean() < 0.01
    else:
        assert winding(corners, np.array([lobe.place]))[0] < -0.5


@pytest.mark.parametrize(
    ("corners", "code"), [(BOW, 1), (HOLLOW, 0)], ids=["bow", "hollow"]
)
def test_the_report_says_what_a_scene_says(
    corners: Array, code: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The file as it is, and as it is written with holes closed."""
    ids = np.arange(3 * len(corners)).reshape(-1, 3)
    file = tmp_path / "bow.obj"
    write_mesh(file, corners.reshape(-1, 3), ids)
    words = [
        "mesh",
        str(file),
        "--scale",
        "1.0",
        "--close",
        str(tmp_path / "closed.obj"),
    ]
    assert main([*words, "--json"]) == code
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    refused = ""
    try:
        prepare_mesh(corners, False, "")
    except ParameterError as error:
        refused = error.text
    assert found["refusal"] == found["close"]["refusal"] == refused
    assert found["is_solid"] == (code == 0)
