"""Small things of the verbs on recordings: words in any order, one named file."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from messages.topics import DEVICE_STATE, FORCE
from nodes.launcher.scenario_files import parse_assignments
from nodes.parameters.store import ParameterError
from nodes.recording.import_table import import_table
from nodes.recording.reader import Recording
from nodes.recording.table import read
from nodes.recording.writer import RecordWriter
from tests.support.launching import typed_in
from tests.support.recorded import PERIOD, drop


@pytest.fixture
def run(tmp_path: Path) -> Path:
    path = tmp_path / "r.mcap"
    manifest = {"rate_hz": repr(1 / PERIOD), "axes": "z", "pace": "lockstep"}
    with RecordWriter(path, manifest) as writer:
        for topic, message in drop(60):
            writer.write(topic, message, message.stamp)
    return path


@pytest.mark.parametrize(
    "words",
    [
        ("r.mcap", "--topics", DEVICE_STATE, FORCE),
        ("--topics", DEVICE_STATE, FORCE, "r.mcap"),
        ("--topics", DEVICE_STATE, FORCE, "--force", "r.mcap"),
    ],
)
def test_topics_and_file_come_in_any_order(run: Path, words: tuple[str, ...]) -> None:
    typed_in(run.parent, "bag", "filter", *words)
    assert set(Recording(run.with_suffix(".filter.mcap")).topics) == {
        DEVICE_STATE,
        FORCE,
    }
    ends = ("--endpoint", f"ipc://{run.parent}/p", "--rate", "inf", "--json")
    played = [word for word in words if word != "--force"]
    done = typed_in(run.parent, "bag", "play", *ends, *played)
    assert set(json.loads(done.stdout)["published"]) == {DEVICE_STATE, FORCE}


def test_a_missing_file_is_asked_for(run: Path) -> None:
    refused = typed_in(run.parent, "bag", "filter", code=2)
    assert "bag filter: needs the file of a recording" in refused.stderr
    refused = typed_in(run.parent, "bag", "filter", "--topics", DEVICE_STATE, code=2)
    assert f"{DEVICE_STATE}: no such file" in refused.stderr


def test_a_file_that_is_named_is_the_one_that_is_written(run: Path) -> None:
    done = typed_in(run.parent, "bag", "export", "r.mcap", "--out", "o.csv", "--json")
    assert json.loads(done.stdout)["files"] == ["o.csv", "o.parameters.json"]
    assert (run.parent / "o.csv").is_file()
    typed_in(run.parent, "bag", "export", "r.mcap", "--out", "o.csv", code=2)
    # It returns every number, as all our exports do.
    found = import_table(run.parent / "o.csv", run.parent / "again.mcap")
    was, now = read(run), read(found.path)
    for column in was:
        np.testing.assert_array_equal(was[column], now[column], err_msg=column)


def test_an_equals_sign_in_place_of_both_is_met() -> None:
    with pytest.raises(ParameterError, match="did you mean stiffness:=900"):
        parse_assignments(["stiffness=900"])
    with pytest.raises(ParameterError, match=r"expected name:=value$"):
        parse_assignments(["what?"])
