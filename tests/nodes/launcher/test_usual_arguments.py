"""Usual arguments of a launch file: a default alone declares them, and ``run`` takes them."""

from __future__ import annotations

from pathlib import Path

import pytest

from nodes.launcher import launch_file, scenario_files
from nodes.launcher.launch_spec import RunSpec
from nodes.launcher.usual_arguments import RUN, USUAL
from nodes.parameters.store import ParameterError

NODES = "nodes: {driver: {kind: sim_driver}}\n"


def written(folder: Path, arguments: str, run: str = "") -> str:
    path = folder / "own.yaml"
    path.write_text(
        f"summary: s\narguments: {{{arguments}}}\n{run}{NODES}", encoding="utf-8"
    )
    return str(path)


def test_a_default_alone_is_the_argument_written_out(tmp_path: Path) -> None:
    short = written(
        tmp_path, "rate: 250.0, pace: lockstep, apply: next_tick, duration: 2.0"
    )
    _, arguments = scenario_files.read_arguments(Path(short))
    assert arguments["rate"].unit == "Hz"
    assert arguments["pace"].choices == ["realtime", "lockstep"]
    run = launch_file.read(short, {}).run
    assert (run.rate, run.pace, run.apply, run.duration) == (
        250.0,
        "lockstep",
        "next_tick",
        2.0,
    )
    assert launch_file.read(short, {"rate": 1000.0}).run.rate == 1000.0


def test_its_limits_hold_and_are_those_of_the_table(tmp_path: Path) -> None:
    short = written(tmp_path, "rate: 500.0, pace: realtime")
    low, high = USUAL["rate"]["min"], USUAL["rate"]["max"]
    for edge in (low, high):
        assert launch_file.read(short, {"rate": edge}).run.rate == edge
    for beyond in (0.99 * low, 1.01 * high):
        with pytest.raises(ParameterError, match="rate"):
            launch_file.read(short, {"rate": beyond})
    with pytest.raises(ParameterError, match="realtime, lockstep"):
        launch_file.read(short, {"pace": "fast"})


def test_what_run_says_itself_stays(tmp_path: Path) -> None:
    own = written(tmp_path, "rate: 500.0", "run: {rate: 100.0}\n")
    assert launch_file.read(own, {"rate": 2000.0}).run.rate == 100.0
    # An argument that is written out is the file's own: run takes nothing from it.
    full = written(tmp_path, "rate: {default: 250.0}")
    assert launch_file.read(full, {}).run.rate == 500.0


def test_another_name_needs_its_words(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match=r"arguments.*expected a mapping"):
        launch_file.read(written(tmp_path, "height: 0.01"), {})


def test_every_setting_of_run_among_them_is_one(tmp_path: Path) -> None:
    assert set(RUN) <= set(USUAL)
    assert set(RUN) <= set(RunSpec.__struct_fields__)
