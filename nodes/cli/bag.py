"""Record, inspect, play back, cut, repair, export and draw recordings."""

import argparse
import contextlib
import math
import os
import re
import signal
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from datetime import datetime
from pathlib import Path

from messages.errors import UsageError
from messages.topics import DEVICE_STATE
from nodes.cli.bag_import import add_import, run_import
from nodes.cli.main import add_json, add_run_name, answer, complain, heeding
from nodes.parameters.quantities import above_zero, not_negative
from nodes.recording.accounts import ClockRecord, Completeness, clocks, completeness
from nodes.recording.facts import period_of, stamped_rate
from nodes.recording.foreign_channels import described
from nodes.recording.reader import Recording
from nodes.recording.writer import RecordError

OWN = ("record", "info", "play", "cut", "filter", "recover", "export", "import", "plot")


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the sub-verbs."""
    sub = parser.add_subparsers(dest="chosen", metavar="|".join(OWN), required=True)

    def declare(
        name: str, run: Callable[[argparse.Namespace], int], text: str
    ) -> argparse.ArgumentParser:
        own = sub.add_parser(name, help=text, description=text)
        own.set_defaults(run=lambda arguments: _checked(run, arguments))
        add_json(own)
        return own

    text = "Record a running launch into an MCAP file, until it ends or Ctrl-C."
    _add_record(declare("record", _record, text))
    info = declare(
        "info",
        _info,
        "Show a recording's topics, message counts, gaps in seq and losses.",
    )
    play = declare(
        "play",
        _play,
        "Publish a recording at its original pace, for PlotJuggler or a node.",
    )
    cut = declare("cut", _extract, "Copy a part of a recording into a new one.")
    cut.set_defaults(topics=[])
    few = declare("filter", _extract, "Copy some topics of a recording into a new one.")
    _add_topics(few)
    recover = declare(
        "recover",
        _recover,
        "Copy everything sound in a cut or damaged recording into a complete one.",
    )
    export = declare(
        "export",
        _export,
        "Write a recording as tables: one row per tick, and the parameters beside them.",
    )
    for own in (info, cut, recover, export):
        own.add_argument("file", type=Path)
    _add_play(play)
    _add_formats(export)
    add_import(
        declare(
            "import",
            run_import,
            "Write a table of another program (CSV, NPZ, …) as a recording.",
        )
    )
    plot = declare(
        "plot",
        _plot,
        "Draw recordings: position, force, energy, response time; several as an overlay.",
    )
    _add_plot(plot)
    for own in (cut, few, plot):
        _add_span(own)
    for own in (cut, few):
        _add_patterns(own)
    for own in (recover, cut, few, export, plot):
        _add_out(own)


def _add_plot(own: argparse.ArgumentParser) -> None:
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


def _add_formats(own: argparse.ArgumentParser) -> None:
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


def _add_file_after_topics(own: argparse.ArgumentParser) -> None:
    """Declare the file; behind --topics, which takes all words, it is the last of them."""
    own.add_argument("file", type=Path, nargs="?")


def _add_topics(own: argparse.ArgumentParser) -> None:
    _add_file_after_topics(own)
    own.add_argument(
        "--topics", nargs="+", default=[], metavar="TOPIC", help="full topic names"
    )


def _add_span(own: argparse.ArgumentParser) -> None:
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


def _add_out(own: argparse.ArgumentParser) -> None:
    default = _OUT[own.prog.rpartition(" ")[2]]
    own.add_argument(
        "--out",
        "-o",
        type=Path,
        metavar="PATH",
        help=f"output (default: {default}, beside the recording)",
    )
    own.add_argument("--force", action="store_true", help="replace existing files")


def _add_record(own: argparse.ArgumentParser) -> None:
    own.add_argument(
        "topics", nargs="*", metavar="TOPIC", help="full topic names (default: all)"
    )
    _add_patterns(own)
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
        help="output directory (default: %(default)s)",
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


def _add_play(own: argparse.ArgumentParser) -> None:
    _add_file_after_topics(own)
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


def _add_patterns(own: argparse.ArgumentParser) -> None:
    own.add_argument("--regex", "-e", metavar="REGEX", help="topics whose names match")
    own.add_argument(
        "--exclude-regex", "-x", metavar="REGEX", help="except topics whose names match"
    )


def _chosen(known: Iterable[str], arguments: argparse.Namespace) -> list[str]:
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


def _checked(
    run: Callable[[argparse.Namespace], int], arguments: argparse.Namespace
) -> int:
    """Run a sub-verb; for a bad file, print a one-line error and return exit code 1."""
    if "file" in arguments and arguments.file is None:
        if not getattr(arguments, "topics", None):
            raise UsageError(f"bag {arguments.chosen}: needs the file of a recording")
        arguments.file = Path(arguments.topics.pop())
    for file in (
        [arguments.file] if "file" in arguments else getattr(arguments, "files", [])
    ):
        # A ROS bag is a folder.
        if not file.exists():
            raise UsageError(f"{file}: no such file")
    try:
        return run(arguments)
    except RecordError as error:
        complain(error)
        return 1


def _opened(file: Path) -> Recording:
    """Open a recording; name on stderr what is not read of it."""
    recording = Recording(file)
    if recording.foreign:
        complain(f"{file}: not read: {described(recording.foreign)}")
    return recording


def _free(out: Path, force: bool) -> Path:
    if out.exists() and not force:
        raise UsageError(
            f"{out}: already exists; replace it with --force, or write elsewhere with --out"
        )
    return out


def _record(arguments: argparse.Namespace) -> int:
    # Install the handler first, so that a signal during the start leaves a complete file too.
    ended: list[int] = []
    with heeding(ended.append):
        from nodes.cli.ask import chosen_run
        from nodes.client.launches import known_topic
        from nodes.recording.logger import record

        run = chosen_run(arguments)
        if arguments.all and arguments.topics:
            raise UsageError(
                f"bag record: --all together with topics ({' '.join(arguments.topics)}); choose one"
            )
        for topic in arguments.topics:
            known_topic(run, topic)
        patterns = arguments.regex or arguments.exclude_regex
        topics = _chosen(run.endpoints(), arguments) if patterns else arguments.topics
        # The process number gives each of several recorders beside one launch its own file.
        out = _free(
            arguments.out or arguments.out_dir / f"{run.run}-{os.getpid()}.mcap",
            arguments.force,
        )
        print(
            f"recording {run.run} into {out}; Ctrl-C ends", file=sys.stderr, flush=True
        )
        count = record(
            run,
            str(out),
            topics,
            lambda: bool(ended),
            arguments.duration or math.inf,
            arguments.force,
        )
        return answer(
            arguments.json,
            {"recording": str(out), "messages": count},
            f"{out}: {count} messages",
        )


def _counted(messages: Mapping[str, int]) -> str:
    return "\n".join(f"  {topic}: {count}" for topic, count in messages.items())


def _in_order(start: float | None, stop: float | None) -> tuple[float, float]:
    begin = start or 0.0
    end = math.inf if stop is None else stop
    if begin >= end:
        raise UsageError(
            f"--from {begin:g} --to {end:g}: the end must come after the beginning"
        )
    return begin, end


def _info_text(
    recording: Recording, verdict: Completeness, remote: Mapping[str, ClockRecord]
) -> str:
    lines = [str(recording.path)]
    facts = dict(recording.manifest)
    with contextlib.suppress(KeyError, ValueError, OverflowError):
        begin = recording.first_log + float(facts["wall_minus_monotonic_s"])
        facts["started"] = (
            datetime.fromtimestamp(begin).astimezone().isoformat(" ", "seconds")
        )
    for name in ("scenario", "run", "imported", "started", "host", "pace", "rate_hz"):
        if name in facts:
            lines.append(f"  {name:9} {facts[name]}")
    stamped = stamped_rate(recording)
    if "rate_hz" not in facts and stamped is not None:
        lines.append(f"  {'rate_hz':9} {stamped:g} by the stamps; the file names none")
    lines.append(
        f"  {'duration':9} {recording.duration:.6g} s (recorded in {recording.wall_duration:.6g} s)"
    )
    lines.append(f"  {'state':9} {verdict.text}")
    if recording.cut:
        lines.append(f"  {'':9} {recording.cut}")
    lines += [f"  {'':9} {text}" for text in _contradictions(recording)]
    width = max(map(len, recording.topics), default=5)
    lines.append(
        f"  {'topic':{width}} {'messages':>9} {'rate [Hz]':>10} {'gaps':>6} {'repeats':>8}"
    )
    for topic, figures in recording.topics.items():
        lines.append(
            f"  {topic:{width}} {figures.messages:9} {figures.rate:10.6g} {figures.gaps:6}"
            f" {figures.back:8}"
        )
    lines += [
        f"  {topic}: {one.messages} messages, not read: {one.text}"
        for topic, one in recording.foreign.items()
    ]
    if verdict.left_out:
        lines.append(
            f"  ticks left out by the driver, late by a whole period: {verdict.left_out} (gaps"
            " on every topic, no losses)"
        )
    for node, account in verdict.nodes.items():
        lines.append(f"  {node}: {account.text}")
    for node, clock in remote.items():
        lines.append(
            f"  {node}: clock {-clock.offset:+.6f} s from the launcher's, known to"
            f" ±{clock.error * 1e6:.0f} µs"
        )
    return "\n".join(lines)


def _contradictions(recording: Recording) -> list[str]:
    """Return what the manifest says against the stamps."""
    if "rate_hz" in recording.manifest and DEVICE_STATE in recording.topics:
        try:
            period_of(recording)
        except RecordError as error:
            return [str(error).removeprefix(f"{recording.path}: ")]
    return []


def _info(arguments: argparse.Namespace) -> int:
    recording = Recording(arguments.file)
    verdict = completeness(recording)
    times = clocks(recording)
    remote = {node: clock for node, clock in times.items() if clock.error}
    figures = {
        "file": str(recording.path),
        "parts": [str(path) for path in recording.parts],
        "duration_s": recording.duration,
        "wall_duration_s": recording.wall_duration,
        "topics": {
            topic: {
                "messages": figures.messages,
                "gaps": figures.gaps,
                "repeats": figures.back,
                "first_seq": figures.first_seq,
                "last_seq": figures.last_seq,
                "rate_hz": figures.rate,
            }
            for topic, figures in recording.topics.items()
        },
        "foreign": {
            topic: {
                "messages": one.messages,
                "encoding": one.encoding,
                "schema": one.schema,
            }
            for topic, one in recording.foreign.items()
        },
        "nodes": {
            node: {
                "sent": account.sent,
                "recorded": account.recorded,
                "lost": account.lost,
            }
            for node, account in verdict.nodes.items()
        },
        "clocks": {
            node: {"offset_s": clock.offset, "error_s": clock.error}
            for node, clock in times.items()
        },
        "lost": verdict.lost,
        "overruns": verdict.left_out,
        "recovered": recording.recovered,
        "complete": recording.complete,
        "cut": recording.cut,
        "manifest": recording.manifest,
    }
    return answer(arguments.json, figures, _info_text(recording, verdict, remote))


def _play(arguments: argparse.Namespace) -> int:
    from messages.transport.context import new_context
    from nodes.cli.relay import local_publisher
    from nodes.recording.play import length_of, play

    recording = _opened(arguments.file)
    names = _remapped(recording, arguments.remap)
    if arguments.start_offset > (length := length_of(recording)):
        raise UsageError(
            f"--start-offset {arguments.start_offset:g}: it lasts {length:g} s"
        )
    counts: dict[str, int] = {}
    interrupts = []

    def interrupt(number: int, _: object) -> None:
        # One that is raised in a finaliser is lost: the loop looks for it, too.
        interrupts.append(number)
        raise KeyboardInterrupt

    context = new_context()
    try:
        publisher = local_publisher(context, arguments.endpoint)
    except UsageError:
        context.destroy(linger=0)
        raise
    before = signal.signal(signal.SIGINT, interrupt)
    try:
        print(
            f"publishing on {arguments.endpoint}; Ctrl-C ends",
            file=sys.stderr,
            flush=True,
        )
        while arguments.wait and not publisher.listeners():
            time.sleep(0.01)
        while True:
            for entry in play(
                recording,
                publisher,
                rate=arguments.rate,
                topics=arguments.topics,
                offset=arguments.start_offset,
                remap=names,
            ):
                name = names.get(entry.topic, entry.topic)
                counts[name] = counts.get(name, 0) + 1
                if interrupts:
                    break
            if interrupts or not (arguments.loop and counts):
                break
    except KeyboardInterrupt:
        print(file=sys.stderr)
    finally:
        signal.signal(signal.SIGINT, before)
        publisher.close()
        context.destroy(linger=0)
    pace = (
        "without a pause"
        if math.isinf(arguments.rate)
        else f"at {arguments.rate:g} times the original pace"
    )
    return answer(
        arguments.json, {"published": counts}, f"published {pace}:\n{_counted(counts)}"
    )


def _remapped(recording: Recording, words: Iterable[str]) -> dict[str, str]:
    names = {}
    for word in words:
        old, sign, new = word.partition(":=")
        if not sign or not new.startswith("/"):
            raise UsageError(
                f"--remap {word}: expected OLD:=NEW, both with a leading slash"
            )
        if old not in recording.topics:
            raise UsageError(
                f"--remap {word}: no topic {old!r}; there are {', '.join(recording.topics)}"
            )
        names[old] = new
    return names


def _extract(arguments: argparse.Namespace) -> int:
    from nodes.recording.recover import extract

    recording = Recording(arguments.file)
    start, stop = _in_order(arguments.start, arguments.stop)
    # Topics of other programs are copied too.
    known = [*recording.topics, *recording.foreign]
    for topic in arguments.topics:
        if topic not in known:
            raise UsageError(
                f"{arguments.file}: no topic {topic!r}; there are {', '.join(known)}"
            )
    topics = _chosen(known, arguments)
    out = _free(
        arguments.out or arguments.file.with_suffix(f".{arguments.chosen}.mcap"),
        arguments.force,
    )
    counts = extract(recording, out, topics, start, stop, overwrite=arguments.force)
    return answer(
        arguments.json,
        {"out": str(out), "messages": counts},
        f"{out}:\n{_counted(counts)}",
    )


def _recover(arguments: argparse.Namespace) -> int:
    from nodes.recording.recover import recover

    out = _free(
        arguments.out or arguments.file.with_suffix(".recovered.mcap"), arguments.force
    )
    saved = recover(arguments.file, out, overwrite=arguments.force)
    lines = [f"{out}: {sum(saved.messages.values())} messages saved"]
    lines += [f"  {topic}: {count}" for topic, count in saved.messages.items()]
    lines += saved.problems or [
        "the recording was complete and sound; nothing was lost"
    ]
    figures = {
        "out": str(out),
        "messages": saved.messages,
        "problems": saved.problems,
        "recovered": bool(saved.problems),
    }
    return answer(arguments.json, figures, "\n".join(lines))


def _export(arguments: argparse.Namespace) -> int:
    from nodes.recording.export import FORMATS as TABLES
    from nodes.recording.export_ros2 import export_ros2
    from nodes.view.foxglove_scene import export_foxglove
    from nodes.view.replay_file import export_html

    formats = {
        **TABLES,
        "ros2": export_ros2,
        "foxglove": export_foxglove,
        "html": export_html,
    }
    source: Path = arguments.file
    ending = arguments.out.suffix.removeprefix(".") if arguments.out else ""
    form = arguments.format or ending or "csv"
    if form not in formats:
        raise UsageError(
            f"{arguments.out}: {ending!r} is not a format; choose one of {', '.join(formats)}"
            " with --format"
        )
    ending = {"csv": "_csv", "ros2": "_ros2", "foxglove": ".foxglove.mcap"}.get(
        form, f".{form}"
    )
    out = _free(
        arguments.out or source.with_name(f"{source.stem}{ending}"), arguments.force
    )
    recording = _opened(source)
    files = formats[form](recording, out, overwrite=arguments.force)
    if form in TABLES:
        try:
            recording.require_ticks()
        except RecordError as error:
            complain(error)  # the other tables are written anyway
    return answer(
        arguments.json,
        {"files": [str(file) for file in files]},
        "\n".join(map(str, files)),
    )


def _plot(arguments: argparse.Namespace) -> int:
    from nodes.recording.overlay import plot_several
    from nodes.recording.plot import plot

    files: list[Path] = arguments.files
    _in_order(start := arguments.start, stop := arguments.stop)
    alone = len(files) == 1 and not arguments.xy
    ending = "" if alone else "_xy" if arguments.xy else "_overlay"
    out = _free(
        arguments.out or files[0].with_name(f"{files[0].stem}{ending}.png"),
        arguments.force,
    )
    recordings = [_opened(file) for file in files]
    if alone:
        plot(recordings[0], out, start=start, stop=stop, overwrite=arguments.force)
    else:
        plot_several(
            recordings,
            out,
            over_position=arguments.xy,
            start=start,
            stop=stop,
            overwrite=arguments.force,
        )
    return answer(arguments.json, {"plot": str(out)}, str(out))
