"""Directories of runs: what bears the mark of a run is removed when the run is over, and nothing else ever is."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from nodes.launcher.runs import MARK, is_marked, new_run_dir, runs_dir, sweep
from tests.support.launching import haptic, private_runtime_dir

LONG_AGO = 3600.0
"""Age of a directory that no launch is still setting up [s]."""


@pytest.fixture
def home(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    with private_runtime_dir() as folder:
        monkeypatch.setenv("HAPTIC_RUNTIME_DIR", str(folder))
        yield folder


def aged(path: Path) -> Path:
    then = time.time() - LONG_AGO
    os.utime(path, (then, then))
    return path


def filled(path: Path) -> Path:
    path.mkdir(mode=0o700, parents=True, exist_ok=True)
    (path / "precious").write_text("mine")
    return aged(path) / "precious"


def test_a_launch_leaves_what_it_did_not_make(tmp_path: Path, home: Path) -> None:
    """Whoever points HAPTIC_RUNTIME_DIR at a private directory of their own keeps what is in it."""
    (home / "runs").mkdir(mode=0o700)
    kept = [filled(home / name) for name in (".ssh", "Documents", "runs/photos")]
    stale = aged(new_run_dir("stale"))
    haptic(tmp_path, "launch", "free_space", "pace:=lockstep", "duration:=0.1", "--no-plot")
    assert [path.read_text() for path in kept] == ["mine"] * 3
    assert not stale.exists(), "what a killed launch left is removed by the next one"
    assert sorted(path.name for path in home.iterdir()) == [".ssh", "Documents", "runs"]


def test_the_sweep_takes_only_what_bears_the_mark(home: Path) -> None:
    mine = aged(new_run_dir("mine"))
    young = new_run_dir("young")
    outside = home / "outside"
    filled(outside)
    (outside / MARK).write_text((mine / MARK).read_text())
    (runs_dir() / "link").symlink_to(outside)
    for name in ("empty-mark", "no-mark", "mark-is-a-folder", "mark-is-a-link"):
        filled(runs_dir() / name)
    (runs_dir() / "empty-mark" / MARK).write_text("")
    (runs_dir() / "mark-is-a-folder" / MARK).mkdir()
    (runs_dir() / "mark-is-a-link" / MARK).symlink_to(mine / MARK)
    for path in runs_dir().iterdir():
        if not path.is_symlink() and path != young:
            aged(path)
    assert is_marked(mine)
    assert sweep() == ["mine"]
    assert (outside / "precious").exists()
    left = {"link", "young", "empty-mark", "no-mark", "mark-is-a-folder", "mark-is-a-link"}
    assert {path.name for path in runs_dir().iterdir()} == left


@pytest.mark.skipif(os.getuid() != 0, reason="only root can make what belongs to somebody else")
def test_the_sweep_leaves_what_belongs_to_somebody_else(home: Path) -> None:
    path = aged(new_run_dir("theirs"))
    os.chown(path, 65534, 65534)
    assert not is_marked(path)
    assert sweep() == []
