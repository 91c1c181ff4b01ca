"""Drags, cuts, plumb lines and coarser meshes of the 3D view, in node against numpy."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import nodes.view
from nodes.view.shape import _part
from nodes.view.tessellation import Patch
from sim.lab.proxy_shapes import icosphere
from tests.support.in_node import node

pytestmark = [pytest.mark.process, pytest.mark.smoke]

CASES, STEEPEST = 400, 4.0
_RUN = """
import { readFileSync } from "node:fs";
import { atDepth, axesOf, depthOf, planeOf, reachOf, stepOf } from "./camera.js";
import { coarser, Solids } from "./solids.js";
const { drags, shape, cuts, points } = JSON.parse(readFileSync(process.argv[2], "utf8"));
const solids = new Solids(shape);
solids.pose(shape.poses);
const coarse = coarser(solids.parts[0], 800);
console.log(JSON.stringify({
  steps: drags.map(({ turn, normal, across, above }) => {
    const axes = axesOf(turn);
    return { ...axes, step: stepOf(axes, normal, across, above) };
  }),
  depths: drags.map(({ turn, normal, target, proxy, depth }) => ({
    at: atDepth(target, proxy, normal, depth),
    ways: ["view", "ground", "surface"].map((mode) => depthOf(mode, axesOf(turn), normal)),
    planes: ["view", "ground", "surface"].map((mode) => planeOf(mode, normal)),
  })),
  cuts: cuts.map(([axis, at]) => solids.cut(axis, at)),
  reach: points.map((point) => reachOf([point, [NaN, NaN, NaN]], [0.01, 0, 0], [0, 2], [300, 200])),
  below: points.map((point) => solids.below(point, -1)),
  coarse: [[...coarse.points], [...coarse.faces]],
}));
"""


def turned(angle: float) -> NDArray[np.float64]:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def mesh(corners: NDArray[np.float64]) -> Patch:
    points, which = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    return Patch(points, which.reshape(-1, 3), flat=True, closed=True)


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    folder = tmp_path_factory.mktemp("maths")
    web = Path(nodes.view.__file__).with_name("web")
    for name in ("camera", "solids", "slabs"):
        shutil.copy(web / f"{name}.js", folder)
    (folder / "package.json").write_text('{"type": "module"}', encoding="utf-8")
    (folder / "run.js").write_text(_RUN, encoding="utf-8")
    random = np.random.default_rng(55)
    normals = random.normal(size=(CASES, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    drags = [
        {
            "turn": {"yaw": random.uniform(-4, 4), "pitch": random.uniform(-1.5, 1.5)},
            "normal": normal.tolist(),
            "across": random.normal() * 1e-3,
            "above": random.normal() * 1e-3,
            "target": random.normal(size=3).tolist(),
            "proxy": random.normal(size=3).tolist(),
            "depth": abs(random.normal()),
        }
        for normal in normals
    ]
    # A ball that stays, one that was moved, and a small one that was turned, too.
    still, small = mesh(icosphere(3, 0.03)), mesh(icosphere(1, 0.01))
    poses = [
        [0.05, 0.0, 0.01, *np.eye(3).ravel()],
        [0.0, 0.06, 0.0, *turned(0.7).ravel()],
    ]
    parts = [_part(still), _part(still, pose=0), _part(small, pose=1)]
    placed = [
        still.corners,
        still.corners + poses[0][:3],
        small.corners @ turned(0.7).T + poses[1][:3],
    ]
    cuts = [[n % 3, random.uniform(-0.04, 0.07)] for n in range(9)]
    points = random.uniform([-0.04, -0.04, -0.04], [0.09, 0.04, 0.06], (60, 3))
    given = {
        "drags": drags,
        "shape": {"parts": parts, "poses": poses},
        "cuts": cuts,
        "points": points.tolist(),
    }
    (folder / "given.json").write_text(json.dumps(given), encoding="utf-8")
    done = subprocess.run(
        [node(), "run.js", "given.json"],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return {**given, "placed": placed, "told": json.loads(done.stdout)}


def test_a_drag_stays_in_its_plane_and_under_the_pointer(found: dict[str, Any]) -> None:
    limited = 0
    for drag, told in zip(found["drags"], found["told"]["steps"], strict=True):
        step, normal = np.array(told["step"]), np.array(drag["normal"])
        right, up, away = (np.array(told[name]) for name in ("right", "up", "away"))
        far = np.hypot(drag["across"], drag["above"])
        assert abs(step @ normal) <= 1e-15  # lengths of mm in double precision
        assert np.linalg.norm(step) <= np.hypot(1.0, STEEPEST) * far * (1 + 1e-12)
        wanted = drag["across"] * right + drag["above"] * up
        if abs(wanted @ normal) <= STEEPEST * far * abs(away @ normal):
            picture = [step @ right, step @ up]
            assert picture == pytest.approx([drag["across"], drag["above"]], abs=1e-14)
        else:
            limited += 1
    assert 0 < limited < CASES // 2


def test_depth_is_away_down_or_into_the_surface(found: dict[str, Any]) -> None:
    for drag, told, step in zip(
        found["drags"], found["told"]["depths"], found["told"]["steps"], strict=True
    ):
        normal, proxy = np.array(drag["normal"]), np.array(drag["proxy"])
        at = np.array(told["at"])
        assert (at - proxy) @ normal == pytest.approx(-drag["depth"], abs=1e-14)
        moved = at - np.array(drag["target"])
        assert np.linalg.norm(np.cross(moved, normal)) < 1e-14
        assert told["ways"][0] == step["away"]
        assert told["ways"][1] == pytest.approx([0.0, 0.0, -1.0])
        assert told["ways"][2] == pytest.approx((-normal).tolist())
        assert told["planes"] == [None, [0, 0, 1], drag["normal"]]


def test_a_cut_has_every_segment_that_the_plane_makes(found: dict[str, Any]) -> None:
    for (axis, at), segments in zip(found["cuts"], found["told"]["cuts"], strict=True):
        wanted = []
        for corners in found["placed"]:
            far = corners[:, :, axis] - at
            for triangle, off in zip(corners, far, strict=True):
                if (off < 0).all() or not (off < 0).any():
                    continue
                ends = []
                for n in range(3):
                    u, v = off[n], off[(n + 1) % 3]
                    if (u < 0) != (v < 0):
                        ends.append(
                            triangle[n]
                            + u / (u - v) * (triangle[(n + 1) % 3] - triangle[n])
                        )
                wanted.append(np.array(ends))
        assert len(segments) == len(wanted)
        # Corners are in single precision; a flat cut of a side shifts its ends by many times that.
        middles = sorted(np.round(np.mean(pair, axis=0), 5).tolist() for pair in wanted)
        told = sorted(np.round(np.mean(pair, axis=0), 5).tolist() for pair in segments)
        assert np.allclose(np.sum(middles, axis=0), np.sum(told, axis=0), atol=2e-3)
        for pair in segments:
            assert [end[axis] for end in pair] == pytest.approx([at, at], abs=1e-8)


def test_a_plumb_line_lands_on_the_first_surface_below(found: dict[str, Any]) -> None:
    corners = np.concatenate(found["placed"][:2])  # turned parts are left out
    landed = 0
    for point, told in zip(found["points"], found["told"]["below"], strict=True):
        flat = corners[:, :, :2] - np.array(point[:2])
        x, y = flat[:, :, 0], flat[:, :, 1]
        parts = np.stack(
            [
                x[:, (k + 1) % 3] * y[:, (k + 2) % 3]
                - y[:, (k + 1) % 3] * x[:, (k + 2) % 3]
                for k in range(3)
            ],
            axis=1,
        )
        inside = (parts >= 0).all(axis=1) | (parts <= 0).all(axis=1)
        heights = (parts[inside] * corners[inside, :, 2]).sum(axis=1) / parts[
            inside
        ].sum(axis=1)
        lower = heights[heights <= point[2]]
        if len(lower):
            landed += 1
            # Single precision, on slopes of at most about 100.
            assert told == pytest.approx(lower.max(), abs=1e-6)
        else:
            assert told == -1
    assert landed > 10


def test_a_coarser_mesh_is_closed_and_near(found: dict[str, Any]) -> None:
    points, faces = (np.array(each) for each in found["told"]["coarse"])
    points, faces = points.reshape(-1, 3), faces.reshape(-1, 3)
    assert 300 < len(faces) <= 800
    edges = np.sort(np.concatenate([faces[:, [k, (k + 1) % 3]] for k in range(3)]), 1)
    _, counts = np.unique(edges, axis=0, return_counts=True)
    assert (counts % 2 == 0).all(), "an edge is open"
    # A corner is the mean of those in a cell: below the ball by half a cell's diagonal at most.
    assert np.linalg.norm(points, axis=1).max() <= 0.03 + 1e-8
    assert np.linalg.norm(points, axis=1).min() >= 0.85 * 0.03


def test_a_section_is_as_large_as_what_moves_in_it(found: dict[str, Any]) -> None:
    """A device beside its scene was cut off by the picture's edge."""
    for point, reach in zip(found["points"], found["told"]["reach"], strict=True):
        # Sides of 300 and 200 pixels: half of the wider one is 1.5 times the reach.
        inside = max(abs(point[0] - 0.01) / (1.5 * reach), abs(point[2]) / reach)
        assert inside == pytest.approx(1.0 / 1.15)
