"""Arguments of verbs that are functions of typed options."""

from __future__ import annotations

import argparse
from dataclasses import dataclass

from nodes.cli.main import Parser
from nodes.parameters.options import Options, argument
from sim.cli.functions import declare


@dataclass(frozen=True, kw_only=True)
class Needed(Options):
    """Options of `survey`."""

    sources: list[str] = argument(nargs="+", metavar="SOURCE", help="folders")


def survey(options: Needed) -> None:
    """Survey folders."""


def test_the_help_of_an_argument_that_must_be_given_names_no_default() -> None:
    parser: argparse.ArgumentParser = Parser()
    declare(survey, parser)
    assert "folders" in parser.format_help()
    assert "MISSING" not in parser.format_help()
    assert parser.parse_args(["a", "b"]).sources == ["a", "b"]
