"""The page on one's own data: its shell lines and its Python run as they are written."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nodes.recording.table import read
from tests.support import ROOT

PAGE = (ROOT / "nodes" / "recording" / "OWN_DATA.md").read_text(encoding="utf-8")


def run(folder: Path, *words: str) -> str:
    """Run a program in a folder; return what it printed."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        words,
        cwd=folder,
        env={**os.environ, "PATH": path},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


SHELL = re.findall(r"```bash\n(.*?)```", PAGE, re.DOTALL)


def shell(folder: Path, number: int) -> None:
    """Run one of the page's blocks; that of the rig is needed by others."""
    run(folder, "bash", "-euo", "pipefail", "-c", SHELL[number])


def only(folder: Path) -> dict[str, Any]:
    """Return the table of the only recording in a folder."""
    (path,) = folder.glob("*.mcap")
    return read(path)


@pytest.mark.slow
@pytest.mark.process
def test_the_rig_of_the_page_is_imported_and_identified(tmp_path: Path) -> None:
    """The page's rig has 0.2 kg; its position is rounded to 10 µm, which costs under 2 %."""
    shell(tmp_path, 0)
    assert {"rig.csv", "rig.mcap", "rig.png"} <= {
        path.name for path in tmp_path.iterdir()
    }
    (code,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    shape, *masses = run(tmp_path, sys.executable, "-c", code).splitlines()
    assert shape.startswith("(4000")
    assert [float(mass) for mass in masses] == pytest.approx([0.2, 0.2], rel=0.02)
    # A bag beside ours: the same run.
    shell(tmp_path, 2)
    was, now = read(tmp_path / "rig.mcap"), read(tmp_path / "from_bag.mcap")
    np.testing.assert_array_equal(was["position"], now["position"])
    np.testing.assert_array_equal(was["force"], now["force"])
    assert (tmp_path / "beside.png").stat().st_size > 10_000


@pytest.mark.slow
@pytest.mark.process
def test_motion_capture_leads_the_device(tmp_path: Path) -> None:
    shell(tmp_path, 1)
    table = only(tmp_path / "walked")
    time, position = table["time"], table["position"]
    for axis, wanted in ((0, 0.04 * np.sin(3 * time)), (1, 0.03 * np.sin(5 * time))):
        # Late by damping over stiffness, 3/150 s, of at most 0.15 m/s.
        assert np.abs(position[150:, axis] - wanted[150:]).max() < 0.006
    # The table is touched where the hand goes below it.
    assert table["force"][:-1, 2].max() > 0.5
    assert (tmp_path / "walk.png").stat().st_size > 10_000


@pytest.mark.slow
@pytest.mark.process
def test_a_cad_file_is_felt_where_it_is(tmp_path: Path) -> None:
    """At rest the spring of 500 N/m bears what the hand's of 150 N/m gives."""
    shell(tmp_path, 3)
    table = only(tmp_path / "felt")
    place, force = table["position"][-2, 2], table["force"][-2, 2]
    # The part ends at 10 mm, the ball's radius is 1 mm; the device still moves by micrometres.
    assert force == pytest.approx(500.0 * (0.011 - place), rel=0.02)
    assert force == pytest.approx(150.0 * place, rel=0.02)
    assert (tmp_path / "part.png").stat().st_size > 5_000


@pytest.mark.slow
@pytest.mark.process
def test_a_drawer_of_another_program_is_pushed(tmp_path: Path) -> None:
    pytest.importorskip("mujoco", reason="things that move need MuJoCo")
    shell(tmp_path, 4)
    table = only(tmp_path / "pushed")
    moving = (table["time"] > 0.6) & (table["time"] < 0.75)
    # At 0.06 m per 0.7 s the rail's damper of 4 N s/m and the tool's of 3 N s/m ask for 0.6 N.
    assert table["force"][moving, 0].mean() == pytest.approx(
        -(4 + 3) * 0.06 / 0.7, rel=0.1
    )
    assert table["position"][-1, 0] == pytest.approx(0.06, abs=1e-3)


def test_the_page_has_five_recipes() -> None:
    assert len(SHELL) == 5
    assert PAGE.count("\n## ") == 5
