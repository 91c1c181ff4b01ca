"""The command line's parser: what argparse would do otherwise."""

from __future__ import annotations

import pytest

from nodes.cli.main import Parser


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
