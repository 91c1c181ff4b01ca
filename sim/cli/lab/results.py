"""Measure the sections of sim/RESULTS.md, and write the page with machine, load and commit."""

from __future__ import annotations

import argparse
from pathlib import Path

from messages.errors import UsageError
from nodes.cli.main import add_json
from sim.cli.answers import report


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        "sections", nargs="*", help="sections to measure; none: only write the page"
    )
    parser.add_argument("--all", action="store_true", help="measure all sections: some hours")
    parser.add_argument("--list", action="store_true", help="list the sections, and measure none")
    parser.add_argument("--page", type=Path, help="where the page goes (default: sim/RESULTS.md)")
    add_json(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Measure what is asked for, write the page, and name the sections that failed."""
    from sim.lab.result_page import (
        PAGE,
        SECTIONS,
        MeasuredOutput,
        ResultsError,
        measure,
        page,
        recorded,
    )
    from sim.measure.stopwatch import say

    unknown = sorted(set(arguments.sections) - set(SECTIONS))
    if unknown:
        raise UsageError(f"{', '.join(unknown)}: no such section; there are {', '.join(SECTIONS)}")
    if arguments.list:
        found = {name: recorded(name) for name in SECTIONS}
        when = {
            name: f"{one.date} at {one.commit}"
            if isinstance(one, MeasuredOutput)
            else ("earlier" if one else "never")
            for name, one in found.items()
        }
        lines = [
            f"{name:15} {one.minutes:4g} min  {when[name]:30}  {one.command}"
            for name, one in SECTIONS.items()
        ]
        return report(arguments, {"sections": when}, lines)
    target = arguments.page or PAGE
    if arguments.page is None and not PAGE.exists():
        raise UsageError(f"{PAGE}: this is no checkout of haptic-nodes; name a file with --page")
    names = list(SECTIONS) if arguments.all else arguments.sections
    failed = {}
    for name in names:
        say(f"{name}: {SECTIONS[name].command}")
        try:
            measure(name)
        except ResultsError as error:
            failed[name] = str(error)
        target.write_text(page(), encoding="utf-8")
    target.write_text(page(), encoding="utf-8")
    lines = [f"{len(names) - len(failed)} of {len(names)} measured", *failed.values(), str(target)]
    return report(arguments, {"failed": failed, "page": str(target)}, lines, held=not failed)
