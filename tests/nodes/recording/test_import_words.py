"""Errors of tables name options as the reader's interface writes them."""

from __future__ import annotations

import argparse
import ast
import shlex
from pathlib import Path

import pytest
import yaml

from nodes.cli import bag_import
from nodes.recording.foreign_table import ForeignTable
from nodes.recording.import_words import (
    COMMAND_LINE,
    LAUNCH_FILE,
    PYTHON,
    ImportWords,
    words,
)
from nodes.recording.imported_samples import samples_of
from nodes.recording.writer import RecordError
from sim.device.hand_path import read_path

CHOSEN = {"position": "x:y:z", "time": "t"}


def test_each_interface_reads_its_words_back() -> None:
    parser = argparse.ArgumentParser()
    bag_import.add_import(parser)
    typed = f"rig.csv {COMMAND_LINE.columns(CHOSEN)} {COMMAND_LINE.unit('time', 'ms')}"
    found = parser.parse_args(
        [*typed.split(), *COMMAND_LINE.ticks.replace("HZ", "500").split()]
    )
    assert found.columns == {"position": ["x", "y", "z"], "time": ["t"]}
    assert (found.units, found.rate, found.ignore_times) == (
        {"time": "ms"},
        500.0,
        True,
    )
    for text, name, given in (
        (PYTHON.columns(CHOSEN), "columns", CHOSEN),
        (PYTHON.unit("time", "ms"), "units", {"time": "ms"}),
    ):
        assert text.partition("=")[0] == name
        assert ast.literal_eval(text.partition("=")[2]) == given
    assert yaml.safe_load(LAUNCH_FILE.columns(CHOSEN)) == {
        "columns": {"position": ["x", "y", "z"], "time": "t"}
    }
    assert yaml.safe_load(LAUNCH_FILE.unit("time", "ms")) == {"units": {"time": "ms"}}


@pytest.mark.parametrize("chosen", [COMMAND_LINE, PYTHON, LAUNCH_FILE])
def test_a_refusal_has_the_words_of_the_interface(chosen: ImportWords) -> None:
    before = words.set(chosen)
    try:
        with pytest.raises(RecordError) as refused:
            samples_of(ForeignTable(Path("rig.csv"), {}))
    finally:
        words.reset(before)
    assert chosen.columns({"position": "NAME"}) in str(refused.value)
    assert ("--" in str(refused.value)) == (chosen is COMMAND_LINE)


def test_a_name_with_spaces_can_be_pasted_into_a_shell() -> None:
    chosen = COMMAND_LINE.columns({"position": "Position x"})
    assert shlex.split(chosen) == ["--columns", "position=Position x"]


def test_rows_as_ticks_are_offered_as_a_hand_takes_them(tmp_path: Path) -> None:
    """A launch file's rate does not replace a column of times, and was offered so."""
    table = tmp_path / "count.csv"
    rows = "".join(f"{k},{1e-4 * k * k!r}\n" for k in range(40))
    table.write_text(f"t,x\n{rows}")
    for rate in (0.0, 500.0):
        with pytest.raises(ValueError, match="rate: HZ without a column of times"):
            read_path(str(table), {}, {}, rate)
    table.write_text(f"count,x\n{rows}")
    corners = read_path(str(table), {}, {}, 500.0)["x"]
    assert corners[-1] == pytest.approx((39 / 500, 1e-4 * 39**2), rel=1e-9)


def test_the_value_of_a_unit_is_offered_as_a_text() -> None:
    offered = LAUNCH_FILE.unit("position", "NUMBER").replace("NUMBER", "0.9144")
    assert yaml.safe_load(offered) == {"units": {"position": "0.9144"}}
