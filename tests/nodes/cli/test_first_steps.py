"""A first user's mistakes: no traceback, no alarm, no escape codes, no unwanted files."""

from __future__ import annotations

import os
import pty
from pathlib import Path

import pytest

from nodes.base.kept_line import is_smart
from nodes.cli.main import main
from tests.support.launching import Running, haptic, typed_in
from tests.support.one_process import recorded


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    return recorded(folder, "floor_drop", "duration:=0.2")


@pytest.mark.process
def test_the_summary_comes_before_the_picture(tmp_path: Path) -> None:
    done = haptic(tmp_path, "launch", "floor_drop", "duration:=0.2", "pace:=lockstep")
    lines = done.stdout.splitlines()
    assert lines[0].startswith("floor_drop: done after 100 ticks")
    assert lines[-1].split()[0] == "plot"
    assert Path(tmp_path, lines[-1].split()[1]).is_file()


@pytest.mark.slow
def test_a_backend_that_is_not_there_does_not_stop_a_plot(recording: Path) -> None:
    out = recording.with_name("backend.png")
    environment = {**os.environ, "MPLBACKEND": "nonsense"}
    haptic(
        recording.parent,
        "bag",
        "plot",
        str(recording),
        "--out",
        str(out),
        environment=environment,
    )
    assert out.stat().st_size > 10_000


def test_an_unknown_ending_is_no_directory(
    recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = recording.with_name("x.foo")
    assert main(["bag", "export", str(recording), "--out", str(out)]) == 2
    assert "'foo' is not a format" in capsys.readouterr().err
    assert not out.exists()


def test_two_loggers_do_not_share_a_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = """
summary: two loggers that record to the same place
nodes:
  driver: {kind: sim_driver, parameters: {device: {mass: 0.1}}}
  environment: {kind: environment, parameters: {surface: {kind: free}}}
  coupling: {kind: coupling, parameters: {law: pd, laws: {pd: {kind: pd, stiffness: 100}}}}
  first: {kind: logger}
  second: {kind: logger}
"""
    path = tmp_path / "both.yaml"
    path.write_text(text, encoding="utf-8")
    assert main(["launch", str(path)]) == 2
    told = capsys.readouterr().err
    assert "first and second both record to" in told
    assert "nodes.second.parameters.path" in told


def test_a_tab_in_yaml_is_called_a_tab(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "tab.yaml"
    path.write_text("summary: x\nnodes:\n\tdriver: {}\n", encoding="utf-8")
    assert main(["launch", str(path)]) == 2
    assert "a tab, where YAML takes spaces" in capsys.readouterr().err


def test_a_dumb_terminal_gets_no_escape_codes(monkeypatch: pytest.MonkeyPatch) -> None:
    ours, theirs = pty.openpty()
    with os.fdopen(theirs, "w") as terminal:
        monkeypatch.setenv("TERM", "xterm")
        assert is_smart(terminal)
        monkeypatch.setenv("TERM", "dumb")
        assert not is_smart(terminal)
    os.close(ours)


def test_keys_that_cannot_be_written_are_told_in_words(tmp_path: Path) -> None:
    in_the_way = tmp_path / "file"
    in_the_way.write_text("")
    environment = {"HAPTIC_KEYS": str(in_the_way / "keys")}
    done = typed_in(tmp_path, "keys", "new", code=2, environment=environment)
    assert "Errno" not in done.stderr
    assert str(in_the_way) in done.stderr
    assert "in $HAPTIC_KEYS" in done.stderr


@pytest.mark.process
def test_a_verb_waits_for_a_launch_that_was_just_started(tmp_path: Path) -> None:
    """The page's lines, pasted: ``haptic launch … &``, then ``haptic law list``."""
    with Running("wall_press", "duration:=0", folder=tmp_path, ready=False) as launch:
        assert "* pd" in launch.haptic("law", "list").stdout
