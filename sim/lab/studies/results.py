"""Measure the sections of sim/RESULTS.md; write the page with machine, load and commit."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from messages.errors import UsageError
from nodes.parameters.options import Options, argument, option
from sim.studies.result import Findings


@dataclass(frozen=True, kw_only=True)
class ResultsOptions(Options):
    """Options of `results`."""

    sections: list[str] = argument(
        default=[], nargs="*", help="sections to measure; none: only write the page"
    )
    all: bool = option(action="store_true", help="measure all sections: some hours")
    list_only: bool = option(
        "--list", action="store_true", help="list the sections, and measure none"
    )
    page: Path | None = option(
        type=Path, help="where the page goes (default: sim/RESULTS.md)"
    )


@dataclass(frozen=True, repr=False, kw_only=True)
class SectionsFound(Findings):
    """When each section was measured: date and commit, earlier or never."""

    sections: dict[str, str]


@dataclass(frozen=True, repr=False, kw_only=True)
class PageWritten(Findings):
    """The page, and the sections that failed."""

    failed: dict[str, str]  # reason by section
    page: Path


def results(options: ResultsOptions) -> SectionsFound | PageWritten:
    """Measure the requested sections, write the page, and report failed sections."""
    from sim.lab.result_page import (
        PAGE,
        SECTIONS,
        MeasuredOutput,
        ResultsError,
        measure,
        page,
        recorded,
    )

    unknown = sorted(set(options.sections) - set(SECTIONS))
    if unknown:
        raise UsageError(
            f"{', '.join(unknown)}: no such section; there are {', '.join(SECTIONS)}"
        )
    if options.list_only:
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
        return SectionsFound(lines=lines, sections=when)
    target = options.page or PAGE
    if options.page is None and not PAGE.exists():
        raise UsageError(
            f"{PAGE}: this is no checkout of haptic-nodes; name a file with --page"
        )
    names = [*SECTIONS] if options.all else options.sections
    step = options.progress(len(names))
    failed = {}
    for name in names:
        try:
            measure(name)
        except ResultsError as error:
            failed[name] = str(error)
        step(f"{name}: {SECTIONS[name].command}")
        target.write_text(page(), encoding="utf-8")
    target.write_text(page(), encoding="utf-8")
    lines = [
        f"{len(names) - len(failed)} of {len(names)} measured",
        *failed.values(),
        str(target),
    ]
    return PageWritten(lines=lines, held=not failed, failed=failed, page=target)
