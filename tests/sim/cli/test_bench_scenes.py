"""The benchmark of scenes refuses invalid options; tests/test_pages.py judges its rows."""

from __future__ import annotations

import pytest

from messages.types import DeviceState
from sim.measure.measured_launch import responses_in
from tests.support.launching import exit_code


def test_what_makes_no_sense_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    for words in (["--finest", "8"], ["--rounds", "0"], ["--seconds", "0"]):
        assert exit_code("bench", "loop", "--scenes", *words) == 2
        assert words[0] in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "option"),
    [
        ("loop --finest 3", "--finest"),
        ("loop --scenes --ticks 100", "--ticks"),
        ("loop --scenes --rates 1000", "--rates"),
        ("view --pictures here --rounds 1", "--rounds"),
    ],
)
def test_what_would_change_nothing_is_refused(
    words: str, option: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert exit_code("bench", *words.split()) == 2
    assert f"{option}: no effect here" in capsys.readouterr().err


def test_ticks_that_the_driver_slept_through_are_missed_too() -> None:
    """On a stalling machine they are the majority, and were not counted."""
    states = [
        DeviceState(
            seq=seq,
            stamp=0.002 * seq,
            position=(0.0, 0.0, 0.0),
            response=1e-4,
            missed=missed,
            overruns=overruns,
        )
        for seq, missed, overruns in (
            (0, 1, 2),
            (1, 2, 2),
            (7, 2, 7),
            (8, 2, 7),
            (9, 4, 7),
        )
    ]
    found = responses_in(states, [(0.0, 0.015), (0.0155, 0.0185)])
    assert (found["missed"], found["ticks"]) == (1 + 5 + 2, 7 + 1)
