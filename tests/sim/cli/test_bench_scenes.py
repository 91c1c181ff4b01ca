"""The benchmark of scenes refuses what makes no sense; its rows are judged where the page runs it (tests/test_pages.py)."""

from __future__ import annotations

import pytest

from tests.support.launching import exit_code


def test_what_makes_no_sense_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    for words in (["--finest", "8"], ["--rounds", "0"], ["--seconds", "0"]):
        assert exit_code("bench", "loop", "--scenes", *words) == 2
        assert words[0] in capsys.readouterr().err
