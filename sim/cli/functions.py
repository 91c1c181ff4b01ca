"""Verbs that are functions of typed options: declare arguments, call, print the result."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import MISSING
from functools import partial
from typing import TYPE_CHECKING, Any

from nodes.cli.main import add_json, answer
from nodes.parameters.options import Options, ProgressStep, options_of

if TYPE_CHECKING:
    from sim.studies.result import StudyResult

PATIENCE = 2.0  # time without a progress display [s]


def declare(function: Any, parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of a function of options, or call its own `add`."""
    if hasattr(function, "add"):
        function.add(parser)
        return
    options = options_of(function)
    for name, one in options.declared().items():
        default = options.default_of(name)
        words = {"help": one.words.get("help"), **one.words}
        if one.positional:
            needed = "nargs" not in words or default is MISSING
            known = {} if needed else {"default": default}
            parser.add_argument(name, **words, **known)
            continue
        if words.get("action") == "on_off":
            words["action"] = argparse.BooleanOptionalAction
        place: Any = parser.add_mutually_exclusive_group() if one.off else parser
        flags = one.flags or (one.flag(name),)
        place.add_argument(*flags, dest=name, default=default, **words)
        if one.off:
            place.add_argument(
                one.off, dest=name, action="store_false", help=one.off_help
            )
    add_json(parser)
    parser.set_defaults(run=partial(_run, function, options))


def progress(total: int) -> ProgressStep:
    """Show progress on standard error, from `PATIENCE` seconds on."""
    from sim.measure.stopwatch import Progress

    return Progress(total, after=PATIENCE).step


def _run(
    function: Callable[[Options], StudyResult],
    kind: type[Options],
    arguments: argparse.Namespace,
) -> int:
    """Call the function and print its result; return the exit code.

    The code is 1 if the verdict is no, and 128 + the signal that ended the function.
    """
    given = {name: getattr(arguments, name) for name in kind.declared()}
    if hasattr(kind, "say"):
        from sim.measure.stopwatch import say

        given["say"] = say
    found = function(kind(**given, progress=progress))
    if found.answer:
        answer(arguments.json, found.answer, found.text)
    if found.interrupted:
        return 128 + found.interrupted
    return 0 if found.held else 1
