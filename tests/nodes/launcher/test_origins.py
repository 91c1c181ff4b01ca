"""Errors name file, line, choices, a suggestion, and the argument that the user wrote."""

from __future__ import annotations

from pathlib import Path

import pytest

from nodes.launcher import launch_file, scenario_files
from nodes.parameters.store import ParameterError
from tests.support.launching import typed_in


@pytest.mark.parametrize(
    ("before", "after", "told"),
    [
        (
            "gravity: 9.81",
            "gravty: 9.81",
            "driver.device.gravty: no such parameter; available: mass, damping, gravity, ",
        ),
        (
            "gravity: 9.81",
            "gravity: soft",
            "driver.device.gravity: expected a number or nothing, got 'soft'",
        ),
        (
            "axis: z",
            "axis: w",
            "environment.surface.axis: expected one of x, y, z, got 'w'",
        ),
        (
            "apply: on_arrival",
            "apply: later",
            "arguments.apply: 'later', expected one of on_arrival, next_tick (the default of ",
        ),
        (
            "    kind: sim_driver",
            "    kind: sim_drive",
            "nodes.driver.kind: 'sim_drive' is not installed; available: ",
        ),
        (
            "position: $(var height)",
            "position: $(var hight)",
            "nodes.driver.parameters.device.position: $(var hight) is",
        ),
    ],
)
def test_a_mistake_in_a_launch_file_is_told_with_its_line(
    before: str, after: str, told: str, tmp_path: Path
) -> None:
    text = (
        scenario_files.find("floor_drop")
        .read_text(encoding="utf-8")
        .replace(before, after, 1)
    )
    (tmp_path / "mine.yaml").write_text(text, encoding="utf-8")
    line = next(i for i, words in enumerate(text.splitlines(), 1) if after in words)
    assert (
        f"haptic: mine.yaml:{line}: {told}"
        in typed_in(tmp_path, "launch", "./mine.yaml", code=2).stderr
    )


def test_what_was_probably_meant(tmp_path: Path) -> None:
    text = (
        scenario_files.find("floor_drop")
        .read_text(encoding="utf-8")
        .replace("gravity:", "gravty:")
    )
    (tmp_path / "mine.yaml").write_text(text, encoding="utf-8")
    for words, meant in (
        (("launch", "./mine.yaml"), "gravity"),
        (("launch", "flor_drop"), "floor_drop"),
        (("launch", "floor_drop", "stifness:=3"), "stiffness"),
        (("launch", "floor_drop", "law:=pd_alfa"), "pd_alpha"),
        (("launch", "floor_drop", "--without", "loger"), "logger"),
        (("lanch",), "launch"),
        (("launch", "floor_drop", "--param", "x.yaml"), "--params"),
        (("study", "kmx"), "kmax"),
        (("study", "kmax", "--gan", "3"), "--gain"),
        (("param", "gett", "coupling", "law"), "get"),
    ):
        assert f"did you mean {meant}?" in typed_in(tmp_path, *words, code=2).stderr, (
            words
        )


def test_an_argument_is_blamed_as_it_was_written(tmp_path: Path) -> None:
    text = scenario_files.find("floor_drop").read_text(encoding="utf-8").splitlines()
    line = 1 + next(
        i for i, words in enumerate(text) if words.strip().startswith("pd: {kind")
    )
    told = typed_in(tmp_path, "launch", "floor_drop", "stiffness:=-1500", code=2).stderr
    assert told.startswith(
        f"haptic: floor_drop.yaml:{line}: coupling.laws.pd.stiffness: "
    )
    assert told.rstrip().endswith("(given as stiffness:=-1500)")


def test_a_file_of_parameters_is_blamed_by_its_own_line(tmp_path: Path) -> None:
    (tmp_path / "over.yaml").write_text(
        "coupling:\n  laws:\n    pd:\n      stiffness: -5.0\n", encoding="utf-8"
    )
    told = typed_in(
        tmp_path, "launch", "floor_drop", "--params", "over.yaml", code=2
    ).stderr
    assert told.startswith("haptic: over.yaml:4: coupling.laws.pd.stiffness: ")
    assert "given as" not in told


def test_a_name_that_no_file_can_have_is_refused() -> None:
    with pytest.raises(ParameterError, match=r"x\.yaml: File name too long"):
        scenario_files.find(f"{'x' * 300}.yaml")
    with pytest.raises(ParameterError, match=r"'x\\udcff\.yaml': not UTF-8"):
        scenario_files.find("x\udcff.yaml")


def test_a_directory_is_no_launch_file(tmp_path: Path) -> None:
    assert (
        "/etc: is a directory, expected a launch file"
        in typed_in(tmp_path, "launch", "/etc", code=2).stderr
    )


def test_an_unknown_option_shows_the_usage_of_its_own_verb(tmp_path: Path) -> None:
    assert typed_in(
        tmp_path, "param", "set", "--jsn", "coupling", "a", "1", code=2
    ).stderr.startswith("usage: haptic param set")


@pytest.mark.parametrize(
    "name", ["run.", "run..", "run.[", "run.a]", "run.rate.", "run.[0]"]
)
def test_a_name_of_run_without_a_name_is_refused(name: str) -> None:
    with pytest.raises(ParameterError, match=r"run\..*no such parameter"):
        launch_file.read("floor_drop", {name: 3})


@pytest.mark.parametrize("name", ["", ".", "a.", "[", "a]"])
def test_a_parameter_without_a_name_is_refused(name: str, tmp_path: Path) -> None:
    text = (
        scenario_files.find("floor_drop")
        .read_text(encoding="utf-8")
        .replace("gravity:", f"'{name}':")
    )
    (tmp_path / "mine.yaml").write_text(text, encoding="utf-8")
    told = typed_in(tmp_path, "launch", "./mine.yaml", code=2).stderr
    assert f"driver.device.{name}: no such parameter" in told
    # A bracket is read as a place in a list, which no line has.
    assert told.startswith("haptic: mine.yaml:") or "[" in name or "]" in name


@pytest.mark.parametrize("node", ["", "[1]", "{kind: [a]}", "{kind: }", "text"])
def test_what_is_no_node_offers_no_device(node: str, tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(f"summary: x\nnodes: {{driver: {node}}}\n", encoding="utf-8")
    assert scenario_files.read_arguments(path) == ("x", {})
    with pytest.raises(ParameterError, match="no argument 'device'"):
        launch_file.read(str(path), {"device": "touch_x"})
    with pytest.raises(ParameterError, match=r"mine\.yaml:2: nodes\.driver"):
        launch_file.read(str(path), {})


def test_a_run_ends_within_what_a_counter_holds() -> None:
    with pytest.raises(
        ParameterError, match=r"run\.duration: expected a number of at most 1000000000"
    ):
        launch_file.read("floor_drop", {"duration": 1e300})
    assert (
        launch_file.read("floor_drop", {"duration": 1e9, "rate": 20000.0}).run.ticks
        < 2**53
    )
