"""Surface, device and axes must match: a wall along an axis not computed is not felt."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from nodes.launcher import launch_file
from nodes.parameters.store import ParameterError
from tests.support.launching import haptic, launch_json, typed_in

SCENE = """
summary: A hand pushes into something
run: {{duration: 0.5, pace: lockstep{axes}}}
nodes:
  driver:
    kind: sim_driver
    parameters:
      device: {{mass: 0.1, damping: 1.0, hand: {{stiffness: 300.0, path: [[0.0, 0.0], [0.1,
        -0.03]]}}}}
  environment: {{kind: environment, parameters: {{surface: {surface}}}}}
  coupling: {{kind: coupling, parameters: {{law: pd, laws: {{pd: {{kind: pd, stiffness: 500.0,
    damping: 3.0}}}}}}}}
"""


def written(folder: Path, surface: str, axes: str = "") -> str:
    (folder / "scene.yaml").write_text(
        SCENE.format(surface=surface, axes=f", axes: {axes}" if axes else "")
    )
    return "./scene.yaml"


def test_axes_are_taken_from_the_surface(tmp_path: Path) -> None:
    for surface, axes in (
        ("{kind: plane, axis: x}", ["x"]),
        ("{kind: plane}", ["z"]),
        ("{kind: free}", ["z"]),
        ("{kind: anchor, position: [0.0, 0.01, 0.0]}", ["y"]),
    ):
        assert (
            launch_file.read(str(tmp_path / written(tmp_path, surface)), {}).run.axes
            == axes
        )
    with pytest.raises(
        ParameterError, match=r"run\.axes: \[z, z\]: an axis is given twice"
    ):
        launch_file.read(
            str(tmp_path / written(tmp_path, "{kind: free}", "[z, z]")), {}
        )


@pytest.mark.process
def test_a_wall_across_x_without_axes_is_felt(tmp_path: Path) -> None:
    figures = launch_json(tmp_path, written(tmp_path, "{kind: plane, axis: x}"))
    assert figures["final"]["force_n"] > 1.0


@pytest.mark.parametrize(
    ("surface", "axes", "told"),
    [
        (
            "{kind: plane, axis: x}",
            "[z]",
            "environment.surface: a plane that pushes along x, but run.axes is [z]",
        ),
        (
            "{kind: anchor, position: [0.0, 0.01, 0.0]}",
            "[x]",
            "pushes along y, but run.axes is [x]",
        ),
    ],
)
def test_a_scene_whose_parts_do_not_meet_is_refused(
    surface: str, axes: str, told: str, tmp_path: Path
) -> None:
    assert (
        told
        in typed_in(tmp_path, "launch", written(tmp_path, surface, axes), code=2).stderr
    )


SLOPE = '''
from nodes.environment.surfaces import Surface

class Slope(Surface, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A floor that leans towards x."""
    kind = "slope"

    def meeting(self):
        def meet(position):
            x, y, z = position
            depth = -z
            return (x + depth, y, 0.0), (0.6, 0.0, 0.8), -depth, depth > 0.0
        return meet
'''


@pytest.mark.process
def test_a_surface_of_another_package_that_pushes_elsewhere_is_told(
    tmp_path: Path,
) -> None:
    info = tmp_path / "site" / "slopes-1.0.dist-info"
    info.mkdir(parents=True)
    (info.parent / "slopes.py").write_text(SLOPE, encoding="utf-8")
    (info / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: slopes\nVersion: 1.0\n", encoding="utf-8"
    )
    (info / "entry_points.txt").write_text(
        "[haptic.surfaces]\nslope = slopes:Slope\n", encoding="utf-8"
    )
    environment = {
        **os.environ,
        "PYTHONPATH": f"{info.parent}{os.pathsep}{os.environ.get('PYTHONPATH', '')}",
    }
    done = haptic(
        tmp_path, "launch", written(tmp_path, "{kind: slope}"), environment=environment
    )
    assert (
        "[environment] axes: the surface pushes along x, but run.axes is [z]: no force there"
        in done.stderr
    )
