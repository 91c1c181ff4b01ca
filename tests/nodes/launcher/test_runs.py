"""Run directories: marked ones are removed when the run is over, others never."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from nodes.launcher.runs import (
    MARK,
    RunError,
    RunInfo,
    find_run,
    hold,
    is_marked,
    name_of,
    new_run_dir,
    runs_dir,
    sweep,
    write_run,
)
from tests.support import ROOT
from tests.support.launching import (
    haptic,
    launch_json,
    private_runtime_dir,
    running,
    typed,
)

LONG_AGO = 3600.0
"""Age at which a directory cannot belong to a starting launch [s]."""


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


@pytest.mark.process
def test_a_launch_leaves_what_it_did_not_make(tmp_path: Path, home: Path) -> None:
    """Files in a user's own HAPTIC_RUNTIME_DIR are not removed."""
    (home / "runs").mkdir(mode=0o700)
    kept = [filled(home / name) for name in (".ssh", "Documents", "runs/photos")]
    stale = aged(new_run_dir("stale"))
    haptic(
        tmp_path, "launch", "free_space", "pace:=lockstep", "duration:=0.1", "--no-plot"
    )
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
    left = {
        "link",
        "young",
        "empty-mark",
        "no-mark",
        "mark-is-a-folder",
        "mark-is-a-link",
    }
    assert {path.name for path in runs_dir().iterdir()} == left


def test_the_sweep_leaves_what_a_launcher_holds(home: Path) -> None:
    """A launch that compiles for over a minute has no nodes yet."""
    path = aged(new_run_dir("compiling"))
    held = hold(path)
    try:
        assert sweep() == []
    finally:
        os.close(held)
    assert sweep() == ["compiling"]


def test_sweeps_at_once_take_each_directory_once(home: Path) -> None:
    names = [f"r{n}" for n in range(40)]
    for name in names:
        aged(new_run_dir(name))
    with ThreadPoolExecutor(4) as pool:
        swept = [pool.submit(sweep) for _ in range(4)]
    assert sorted(name for each in swept for name in each.result()) == sorted(names)


@pytest.mark.skipif(
    os.getuid() != 0, reason="only root can make what belongs to somebody else"
)
def test_the_sweep_leaves_what_belongs_to_somebody_else(home: Path) -> None:
    path = aged(new_run_dir("theirs"))
    os.chown(path, 65534, 65534)
    assert not is_marked(path)
    assert sweep() == []


@pytest.mark.parametrize("base", ["/run/user/1000/haptic", "/run/user/1234567/haptic"])
def test_a_long_scenario_starts_where_desktops_keep_runs(
    base: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Socket paths have at most 107 bytes, node names 32."""
    with private_runtime_dir() as folder:
        home = folder / ("d" * (len(base) - len(str(folder)) - 1))
        assert len(str(home)) == len(base)
        monkeypatch.setenv("HAPTIC_RUNTIME_DIR", str(home))
        names = [f"{'s' * 18}-20261122-142531-62240{n}" for n in range(2)]
        made = [new_run_dir(name) for name in names]
        assert made[0] != made[1]
        for path in made:
            with socket.socket(socket.AF_UNIX) as longest:
                longest.bind(str(path / ("n" * 32 + ".listen")))
        with pytest.raises(RunError, match="already exists"):
            new_run_dir(names[0])


@pytest.mark.process
def test_a_run_in_a_short_directory_is_found_by_its_name(
    home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    deep = home / ("d" * 28)
    environment = {**os.environ, "HAPTIC_RUNTIME_DIR": str(deep)}
    done = haptic(
        tmp_path,
        "launch",
        "floor_drop_fast",
        "pace:=lockstep",
        "duration:=0.1",
        "--no-plot",
        environment=environment,
    )
    assert "done after" in done.stdout
    monkeypatch.setenv("HAPTIC_RUNTIME_DIR", str(deep))
    name = "s" * 40
    path = new_run_dir(name)
    assert path.name != name
    write_run(path, RunInfo(run=name, scenario="s", launcher=os.getpid(), nodes={}))
    assert find_run(name).run == name
    sweep()
    assert path.exists()


@pytest.mark.process
def test_a_run_in_a_short_directory_is_stopped_by_its_name(tmp_path: Path) -> None:
    """With a shortened directory, `haptic stop` sent no signal and gave up."""
    file = tmp_path / f"{'a' * 64}.yaml"
    file.write_text(
        (ROOT / "launch" / "free_space.yaml").read_text(encoding="utf-8"),
        encoding="utf-8",
    )
    with running(tmp_path, str(file), "duration:=600") as run:
        assert run.run_dir.name != run.run.run
        with pytest.raises(BlockingIOError):
            hold(run.run_dir)
        typed(run, "stop")
        assert run.finish(code=130)["exit_reason"] == "stopped by haptic stop"


@pytest.mark.parametrize(
    "scenario",
    [
        "two#walls",
        "a/b",
        ".hidden",
        "x\udcff",
        "it's {run} %s\n",
        "\N{MATHEMATICAL BOLD SMALL A}" * 99,
    ],
    ids=["key", "folder", "hidden", "not UTF-8", "signs", "long"],
)
def test_a_run_s_name_is_one_that_files_and_endpoints_bear(scenario: str) -> None:
    name = name_of(scenario)
    assert len(os.fsencode(f"{name}-{'n' * 30}.mcap")) <= 255
    assert name.isprintable()
    assert not set(name) & set("#/ '{}%")
    assert not name.startswith(".")
    name.encode()


@pytest.mark.process
def test_a_launch_file_of_an_odd_long_name_runs(tmp_path: Path) -> None:
    file = tmp_path / f"wall #1, it's {'ü' * 110}.yaml"
    file.write_text(
        (ROOT / "launch" / "free_space.yaml").read_text(encoding="utf-8"),
        encoding="utf-8",
    )
    figures = launch_json(tmp_path, str(file), "pace:=lockstep", "duration:=0.1")
    assert (figures["ticks"], figures["scenario"]) == (50, file.stem)
    assert (tmp_path / figures["recording"]).is_file()


def test_a_runtime_directory_that_no_endpoint_can_name_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HAPTIC_RUNTIME_DIR", str(tmp_path / "a#b"))
    with pytest.raises(RunError, match="a#b: contains a #"):
        runs_dir()
    assert not (tmp_path / "a#b").exists()


def test_nobody_is_told_to_remove_the_directory_of_another_user(
    home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    owner = os.getuid()
    monkeypatch.setattr(os, "getuid", lambda: owner + 1)
    with pytest.raises(
        RunError, match="set HAPTIC_RUNTIME_DIR to one of your own"
    ) as refused:
        runs_dir()
    assert "remove" not in str(refused.value)
