"""Import a table of another program (CSV, NPZ, MAT, Parquet) or a ROS bag as a recording."""

from __future__ import annotations

import argparse
from pathlib import Path

from messages.errors import UsageError
from nodes.cli.main import answer, complain
from nodes.parameters.quantities import declare
from nodes.recording.writer import RecordError


def add_import(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        "file",
        type=Path,
        help="the table, with a line of names if it is text; or a ROS bag",
    )
    parser.add_argument(
        "--out",
        "-o",
        type=Path,
        metavar="RUN.mcap",
        help=(
            "the recording (default: FILE.mcap beside the file, of an MCAP file"
            " FILE_imported.mcap)"
        ),
    )
    parser.add_argument(
        "--columns",
        type=columns_of,
        default={},
        metavar="ROLE=NAME,…",
        help=(
            "columns of position, force and time, e.g. position=x,force=F, or"
            " position=px:py:pz for three axes (default: those of the usual names); of a ROS bag"
            " topics, e.g. position=/arm/pose,force=/ft/wrench"
        ),
    )
    parser.add_argument(
        "--units",
        type=units_of,
        default={},
        metavar="ROLE=UNIT,…",
        help=(
            "units, e.g. position=mm,time=ms,force=mN, mm alone for positions, or the SI value of"
            " a count as a number (default: those in the names of the columns, else SI)"
        ),
    )
    declare(parser, rate=None)
    parser.add_argument(
        "--ignore-times",
        action="store_true",
        help="each row is a tick, whatever its time",
    )
    parser.add_argument(
        "--axis",
        choices=("x", "y", "z"),
        help="axis of a single column (default: as named, or x)",
    )
    parser.add_argument(
        "--decimal-comma", action="store_true", help="the file writes 0,5 for 0.5"
    )
    parser.add_argument(
        "--force", action="store_true", help="replace an existing recording"
    )
    # A CSV export is a directory.
    parser.set_defaults(run=run_import)


def _pairs(text: str) -> dict[str, str]:
    found = {}
    for part in text.split(","):
        role, equals, value = part.partition("=")
        if not equals or not value.strip():
            raise argparse.ArgumentTypeError(f"{part!r} is not ROLE=NAME")
        found[role.strip()] = value.strip()
    return found


def columns_of(text: str) -> dict[str, list[str]]:
    """Return columns by role; three axes are separated by colons."""
    return {role: value.split(":") for role, value in _pairs(text).items()}


def units_of(text: str) -> dict[str, str]:
    """Return units by role; a unit alone is that of positions."""
    return _pairs(text) if "=" in text else {"position": text.strip()}


def run_import(arguments: argparse.Namespace) -> int:
    """Write the recording and print what was read from which column."""
    from nodes.recording.bag_table import bag_of
    from nodes.recording.import_table import import_table

    file: Path = arguments.file
    if not file.exists():
        raise UsageError(f"{file}: no such file")
    # Beside a bag, not in it; a folder may be given as "." or "..".
    named = file if file.is_dir() else bag_of(file) or file
    named = named.resolve() if named.name in ("", "..") else named
    if not (named.name or arguments.out):
        raise UsageError(f"{file}: write the recording elsewhere with --out")
    # Not the file of a bag itself.
    is_mcap = named.suffix == ".mcap" and named.is_file()
    stem = f"{named.stem}_imported" if is_mcap else named.stem
    out = arguments.out or named.with_name(f"{stem}.mcap")
    if out.exists() and not arguments.force:
        raise UsageError(
            f"{out}: already exists; replace it with --force, or write elsewhere with --out"
        )
    try:
        found = import_table(
            file,
            out,
            columns=arguments.columns,
            units=arguments.units,
            rate=arguments.rate,
            axis=arguments.axis,
            ignore_times=arguments.ignore_times,
            decimal_comma=arguments.decimal_comma,
            overwrite=arguments.force,
        )
    except RecordError as error:
        complain(error)
        return 1
    samples = found.samples
    figures = {
        "recording": str(out),
        "ticks": len(samples.seq),
        "rate_hz": 1.0 / samples.period,
        "axes": samples.axes,
        "sources": samples.sources,
    }
    return answer(arguments.json, figures, found.text)
