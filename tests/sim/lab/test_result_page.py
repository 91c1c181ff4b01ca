"""sim/RESULTS.md is the output of `haptic lab results`, with machine, load and commit."""

from __future__ import annotations

import re
from pathlib import Path

import msgspec
import pytest

from nodes.cli.main import main
from sim.lab import result_page
from sim.lab.result_page import (
    MEASURED,
    PAGE,
    ROOT,
    SECTIONS,
    MeasuredOutput,
    ResultSection,
    ResultsError,
    measure,
    page,
    recorded,
    section,
)

RECORD = MeasuredOutput(
    command="haptic law list",
    date="2026-11-27T06:00Z",
    commit="0123abcd",
    machine="a machine",
    load=(1.0, 2.5),
    seconds=3.5,
    printed="a figure\nstudies/figure.png\n" + "long " * 40,
)


def test_the_page_is_what_the_command_writes() -> None:
    assert PAGE.read_text(encoding="utf-8") == page()


def test_every_file_belongs_to_a_section() -> None:
    assert {path.stem for path in MEASURED.iterdir()} <= set(SECTIONS)


def test_a_section_names_command_machine_load_and_commit(tmp_path: Path) -> None:
    (tmp_path / "loop.json").write_bytes(msgspec.json.encode(RECORD))
    text = section("loop", tmp_path)
    for told in (
        "$ haptic law list",
        "0123abcd",
        "load of 1 to 2.5",
        "a machine",
        "a figure",
    ):
        assert told in text
    assert "studies/" not in text
    assert max(map(len, text.splitlines())) <= 100


def test_a_command_is_one_of_haptic_or_of_the_interpreter() -> None:
    for told in SECTIONS.values():
        program, *words = told.command.split()
        haptic = ["-m", "nodes.cli.command"] if program == "haptic" else []
        assert result_page._program(told.command) == [*haptic, *words]
        assert program in ("haptic", "python")


@pytest.mark.process
@pytest.mark.skipif(
    not (ROOT / ".git").exists(), reason="names its commit: needs a checkout"
)
def test_a_measured_section_replaces_what_was_measured_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(
        SECTIONS,
        "loop",
        ResultSection("The loop", "?", "haptic study kmax --law pd --gain 3", 0.1),
    )
    (tmp_path / "loop.md").write_text("an earlier figure\n", encoding="utf-8")
    assert "an earlier figure" in section("loop", tmp_path)
    record = measure("loop", tmp_path)
    assert recorded("loop", tmp_path) == record
    # The closed form, as on sim/README.md.
    assert "3781.87 N/m" in record.printed
    assert re.fullmatch(r"[0-9a-f]{8}\+?", record.commit)
    assert not (tmp_path / "loop.md").exists()


@pytest.mark.process
@pytest.mark.skipif(
    not (ROOT / ".git").exists(), reason="names its commit: needs a checkout"
)
def test_a_command_that_fails_leaves_its_section_and_is_printed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    fails = """python -c 'print("one of two failed"); raise SystemExit(2)'"""
    monkeypatch.setitem(SECTIONS, "loop", ResultSection("The loop", "?", fails, 0.1))
    (tmp_path / "loop.md").write_text("an earlier figure\n", encoding="utf-8")
    with pytest.raises(ResultsError, match="exit code 2; not recorded"):
        measure("loop", tmp_path)
    assert recorded("loop", tmp_path) == "an earlier figure\n"
    assert "one of two failed" in capsys.readouterr().err


def test_an_unknown_section_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["lab", "results", "lop"]) == 2
    assert "lop: no such section; there are k_max" in capsys.readouterr().err


def test_outside_a_checkout_a_file_is_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(result_page, "PAGE", tmp_path / "sim" / "RESULTS.md")
    assert main(["lab", "results"]) == 2
    assert "name a file with --page" in capsys.readouterr().err
    assert main(["lab", "results", "--page", str(tmp_path / "here.md")]) == 0
    assert (tmp_path / "here.md").read_text(encoding="utf-8") == page()
