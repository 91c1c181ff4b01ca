"""The command line's parser: what argparse would do otherwise."""

from __future__ import annotations

import argparse
from typing import Any

import pytest

from nodes.cli.main import Parser, main


@pytest.mark.parametrize("default", [["pd"], []])
def test_a_list_given_twice_grows_and_replaces_the_default(default: list[str]) -> None:
    parser = Parser()
    parser.add_argument("--law", nargs="+", default=default)
    words = ["--law", "a", "b", "--law", "c"]
    assert parser.parse_args([]).law == default
    # The default must not grow from call to call.
    assert [parser.parse_args(words).law for _ in range(2)] == [["a", "b", "c"]] * 2


def test_a_list_within_a_verb_grows_too() -> None:
    parser = Parser()
    verb = parser.add_subparsers().add_parser("study")
    verb.add_argument("--law", nargs="+", default=["pd"])
    assert parser.parse_args(["study", "--law", "a", "--law", "b"]).law == ["a", "b"]
    assert parser.parse_args(["study"]).law == ["pd"]


@pytest.mark.parametrize(
    ("default", "end"),
    [
        (2.0, "how long (default: 2)"),
        (1, "how long (default: 1)"),
        ("50%", "how long (default: 50%)"),
        ([1.0, 2.5], "how long (default: 1 2.5)"),
        ((0.5, 1.0), "how long (default: 0.5..1)"),
        (None, "how long"),
        (False, "how long"),
        (True, "how long"),
        (0, "how long"),
        ("", "how long"),
        ([], "how long"),
        (argparse.SUPPRESS, "how long"),
    ],
)
def test_a_help_text_ends_with_the_default(default: Any, end: str) -> None:
    parser = Parser()
    parser.add_argument("--time", default=default, help="how long")
    assert parser.format_help().rstrip().endswith(end)


def test_a_default_that_the_text_tells_is_told_once() -> None:
    parser = Parser()
    parser.add_argument("--time", default=3, help="how long (default: as the run)")
    assert parser.format_help().count("default") == 1


@pytest.mark.parametrize(
    "word", ["coupling.laws.pd.stiffness=500", "coupling.laws.pd.stiffness:=500"]
)
def test_a_parameter_as_a_launch_takes_it_is_put_right(
    word: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["param", "set", word]) == 2
    meant = "did you mean coupling laws.pd.stiffness 500?"
    assert meant in capsys.readouterr().err
    assert main(["param", "set", "coupling"]) == 2
    assert "expected NODE NAME VALUE\n" in capsys.readouterr().err
