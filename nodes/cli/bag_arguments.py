"""Arguments of the verbs of `haptic bag`: their declarations, and what they choose."""

import argparse
import math
import re
from collections.abc import Iterable, Mapping
from pathlib import Path

from messages.errors import UsageError
from nodes.cli.main import add_run_name, complain
from nodes.parameters.quantities import above_zero, not_negative
from nodes.recording.foreign_channels import described
from nodes.recording.reader import Recording


def add_plot(own: argparse.ArgumentParser) -> None:
    """Declare the files of a plot, and how it draws them."""
    own.add_argument("files", type=Path, nargs="+", metavar="file")
    own.add_argument(
        "--xy",
        action="store_true",
        help="draw force over position instead of both over time",
    )


_OUT = {
    "recover": "FILE.recovered.mcap",
    "cut": "FILE.cut.mcap",
    "filter": "FILE.filter.mcap",
    "export": (
        "the directory FILE_csv or FILE_ros2, or FILE.npz, .mat, .parquet, .foxglove.mcap"
    ),
    "plot": "FILE.png, FILE_xy.png or FILE_overlay.png; the suffix .svg or .pdf sets the format",
}


def add_formats(own: argparse.ArgumentParser) -> None:
    """Declare the format of an export."""
    own.add_argument(
        "--format",
        choices=("csv", "npz", "mat", "parquet", "ros2", "foxglove", "html"),
        help=(
            "csv: a directory, also with a file per topic (default); npz: numpy; mat: MATLAB;"
            " parquet: ticks only; ros2: a directory for ros2 bag play; foxglove: the"
            " recording with its scene in 3D; html: its page in one file, which opens without a"
            " server (default: from the suffix of --out)"
        ),
    )


def add_file_after_topics(own: argparse.ArgumentParser) -> None:
    """Declare the file; behind --topics, which takes all words, it is the last of them."""
    own.add_argument("file", type=Path, nargs="?")


def add_topics(own: argparse.ArgumentParser) -> None:
    """Declare a file, and its topics by name."""
    add_file_after_topics(own)
    own.add_argument(
        "--topics", nargs="+", default=[], metavar="TOPIC", help="full topic names"
    )


def add_span(own: argparse.ArgumentParser) -> None:
    """Declare the part of a recording by time."""
    own.add_argument(
        "--from",
        type=not_negative,
        dest="start",
        metavar="S",
        help="start at this time of the run [s]",
    )
    own.add_argument(
        "--to",
        type=not_negative,
        dest="stop",
        metavar="S",
        help="stop at this time [s]",
    )


def add_out(own: argparse.ArgumentParser) -> None:
    """Declare the output of a verb."""
    default = _OUT[own.prog.rpartition(" ")[2]]
    own.add_argument(
        "--out",
        "-o",
        type=Path,
        metavar="PATH",
        help=f"output (default: {default}, beside the recording)",
    )
    own.add_argument("--force", action="store_true", help="replace existing files")


def add_record(own: argparse.ArgumentParser) -> None:
    """Declare what is recorded of a launch, and where to."""
    own.add_argument(
        "topics", nargs="*", metavar="TOPIC", help="full topic names (default: all)"
    )
    add_patterns(own)
    own.add_argument(
        "--all", "-a", action="store_true", help="record all topics (the default)"
    )
    own.add_argument(
        "--out",
        "-o",
        type=Path,
        metavar="FILE",
        help="output file (default: OUT_DIR/RUN-PID.mcap)",
    )
    own.add_argument(
        "--out-dir",
        type=Path,
        default=Path("recordings"),
        metavar="DIR",
        help="output directory",
    )
    own.add_argument("--force", action="store_true", help="replace an existing file")
    add_run_name(own)
    own.add_argument(
        "--duration",
        type=above_zero,
        default=0.0,
        metavar="S",
        help="record for S seconds from the first message",
    )


def add_play(own: argparse.ArgumentParser) -> None:
    """Declare how a recording is published again."""
    add_file_after_topics(own)
    own.add_argument(
        "--endpoint",
        default="tcp://127.0.0.1:9872",
        help="endpoint to publish on (default: %(default)s, PlotJuggler's)",
    )
    own.add_argument(
        "--rate",
        "-r",
        type=above_zero,
        default=1.0,
        help="speed factor: 1 is the original pace, inf does not wait",
    )
    own.add_argument("--loop", "-l", action="store_true", help="repeat until Ctrl-C")
    own.add_argument(
        "--topics", nargs="+", metavar="TOPIC", help="topics to publish (default: all)"
    )
    own.add_argument(
        "--start-offset",
        type=not_negative,
        default=0.0,
        metavar="S",
        help="start S seconds into the recording",
    )
    own.add_argument(
        "--remap",
        "-m",
        nargs="+",
        default=[],
        metavar="OLD:=NEW",
        help="publish topic OLD as NEW",
    )
    own.add_argument(
        "--wait",
        action="store_true",
        help="wait for a subscriber before the first message",
    )


def add_patterns(own: argparse.ArgumentParser) -> None:
    """Declare topics by regular expressions."""
    own.add_argument("--regex", "-e", metavar="REGEX", help="topics whose names match")
    own.add_argument(
        "--exclude-regex", "-x", metavar="REGEX", help="except topics whose names match"
    )


def chosen_topics(known: Iterable[str], arguments: argparse.Namespace) -> list[str]:
    """Return the topics that names and patterns select; all if neither is given."""
    try:
        wanted = re.compile(arguments.regex or "")
        unwanted = (
            None
            if arguments.exclude_regex is None
            else re.compile(arguments.exclude_regex)
        )
    except re.error as error:
        raise UsageError(
            f"bag {arguments.chosen}: {error.pattern!r} is not a regular expression: {error}"
        ) from error
    known = list(known)
    named = [
        topic
        for topic in known
        if topic in arguments.topics or (arguments.regex and wanted.search(topic))
    ]
    chosen = named if arguments.topics or arguments.regex else known
    left = [topic for topic in chosen if unwanted is None or not unwanted.search(topic)]
    if not left:
        raise UsageError(
            f"bag {arguments.chosen}: no topic matches; there are {', '.join(known)}"
        )
    return left


def opened(file: Path) -> Recording:
    """Open a recording; name on stderr what is not read of it."""
    recording = Recording(file)
    if recording.foreign:
        complain(f"{file}: not read: {described(recording.foreign)}")
    return recording


def free_file(out: Path, force: bool) -> Path:
    """Return the output; raises UsageError where it exists and `force` is not given."""
    if out.exists() and not force:
        raise UsageError(
            f"{out}: already exists; replace it with --force, or write elsewhere with --out"
        )
    return out


def counted(messages: Mapping[str, int]) -> str:
    """Return messages by topic as lines of text."""
    return "\n".join(f"  {topic}: {count}" for topic, count in messages.items())


def span_of(start: float | None, stop: float | None) -> tuple[float, float]:
    """Return beginning and end of a part [s]; raises UsageError if they are not in order."""
    begin = start or 0.0
    end = math.inf if stop is None else stop
    if begin >= end:
        raise UsageError(
            f"--from {begin:g} --to {end:g}: the end must come after the beginning"
        )
    return begin, end
