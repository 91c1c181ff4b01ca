"""Record, inspect, play back, repair, export and draw recordings."""

from __future__ import annotations

import argparse
import contextlib
import math
import sys
from collections.abc import Callable, Mapping
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from nodes.cli.main import UsageError, answer

if TYPE_CHECKING:
    from nodes.recording.accounts import Account, Clock
    from nodes.recording.reader import Recording

PLAY_ENDPOINT = "tcp://127.0.0.1:9872"
"""Where `play` publishes unless told otherwise: PlotJuggler's ZeroMQ plug-in looks there by default."""

_LOCAL = ("tcp://127.0.0.1:", "tcp://localhost:", "tcp://[::1]:", "ipc://")


def _positive(text: str) -> float:
    value = float(text)
    if not value > 0.0:
        raise argparse.ArgumentTypeError(f"{text} must be above 0")
    return value


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the sub-verbs.

    Parameters
    ----------
    parser : argparse.ArgumentParser
        Parser of the verb ``bag``.
    """
    sub = parser.add_subparsers(dest="chosen", metavar="record|info|play|recover|export|plot", required=True)

    def declare(name: str, run: Callable[[argparse.Namespace], int], text: str) -> argparse.ArgumentParser:
        own = sub.add_parser(name, help=text, description=text)
        own.set_defaults(run=lambda arguments: _told(run, arguments))
        own.add_argument("--json", action="store_true", help="answer with one JSON object on the last line")
        return own

    record = declare("record", _record, "Record a running launch into an MCAP file, until it ends or Ctrl-C.")
    record.add_argument("topics", nargs="*", metavar="TOPIC", help="topics to record; all when left out")
    record.add_argument(
        "--out", "-o", type=Path, metavar="FILE", help="file to write (default: recordings/RUN-PID.mcap)"
    )
    record.add_argument("--force", action="store_true", help="replace a file that is there already")
    record.add_argument("--run", metavar="NAME", dest="run_name", help="which launch, when several are running")
    record.add_argument("--duration", type=_positive, default=0.0, metavar="S", help="stop after so many seconds")

    info = declare("info", _info, "Tell what a recording holds: topics, messages, gaps in seq, sent against recorded.")
    info.add_argument("file", type=Path)

    play = declare("play", _play, "Publish a recording at its original pace, for PlotJuggler or a node to listen to.")
    play.add_argument("file", type=Path)
    play.add_argument("--endpoint", default=PLAY_ENDPOINT, help="where to publish (default: %(default)s)")
    play.add_argument("--rate", type=_positive, default=1.0, help="speed, 1 is the original pace, inf does not wait")
    play.add_argument("--topics", nargs="+", metavar="TOPIC", help="topics to publish; all when left out")
    play.add_argument("--wait", action="store_true", help="wait for a listener before the first message")

    recover = declare("recover", _recover, "Copy all that is sound in a cut or damaged recording into a complete one.")
    recover.add_argument("file", type=Path)

    export = declare("export", _export, "Write a recording as CSV (one file per topic) or as NPZ (arrays).")
    export.add_argument("file", type=Path)
    export.add_argument("--format", choices=("csv", "npz"), default="csv", help="default: %(default)s")

    plot = declare("plot", _plot, "Draw a recording: position, force, response time (PNG).")
    plot.add_argument("file", type=Path)

    for own, default in (
        (recover, "FILE.recovered.mcap"),
        (export, "the directory FILE_csv, or FILE.npz"),
        (plot, "FILE.png"),
    ):
        own.add_argument(
            "--out", "-o", type=Path, metavar="PATH", help=f"what to write (default: {default}, beside it)"
        )
        own.add_argument("--force", action="store_true", help="replace what is there already")


def _told(run: Callable[[argparse.Namespace], int], arguments: argparse.Namespace) -> int:
    """Run a sub-verb; a bad file is told in one line, exit code 1."""
    from nodes.recording.writer import RecordError

    if "file" in arguments and not arguments.file.is_file():
        raise UsageError(f"{arguments.file}: no such file")
    try:
        return run(arguments)
    except RecordError as error:
        print(f"haptic: {error}", file=sys.stderr)
        return 1


def _free(out: Path, force: bool) -> Path:
    if out.exists() and not force:
        raise UsageError(f"{out}: exists already; replace it with --force, or write elsewhere with --out")
    return out


def _record(arguments: argparse.Namespace) -> int:
    import os

    from nodes.launcher.runs import RunError, find_run
    from nodes.recording.logger import record

    try:
        run = find_run(arguments.run_name)
    except RunError as error:
        raise UsageError(str(error)) from error
    # Several recorders beside one launch each get a file of their own.
    out = _free(arguments.out or Path("recordings") / f"{run.run}-{os.getpid()}.mcap", arguments.force)
    print(f"recording {run.run} into {out}; Ctrl-C ends", file=sys.stderr, flush=True)
    count = record(run, str(out), arguments.topics, arguments.duration, arguments.force)
    answer(arguments.json, {"recording": str(out), "messages": count}, f"{out}: {count} messages")
    return 0


def _info_text(recording: Recording, nodes: Mapping[str, Account], left_out: int, remote: Mapping[str, Clock]) -> str:
    lines = [str(recording.path)]
    facts = dict(recording.manifest)
    with contextlib.suppress(KeyError, ValueError, OverflowError):
        begin = recording.first_log + float(facts["wall_minus_monotonic_s"])
        facts["started"] = datetime.fromtimestamp(begin).astimezone().isoformat(" ", "seconds")
    for name in ("scenario", "run", "started", "host", "pace", "rate_hz"):
        if name in facts:
            lines.append(f"  {name:9} {facts[name]}")
    lines.append(f"  {'duration':9} {recording.duration:.6g} s (recorded in {recording.wall_duration:.6g} s)")
    lines.append(f"  {'state':9} {'complete' if recording.complete else recording.cut}")
    width = max(map(len, recording.topics), default=5)
    lines.append(f"  {'topic':{width}} {'messages':>9} {'rate [Hz]':>10} {'gaps':>6} {'repeats':>8}")
    for topic, figures in recording.topics.items():
        lines.append(f"  {topic:{width}} {figures.messages:9} {figures.rate:10.6g} {figures.gaps:6} {figures.back:8}")
    if left_out:
        lines.append(f"  ticks left out by the driver, late by a whole period: {left_out} (gaps everywhere, no losses)")
    for node, account in nodes.items():
        told = "all there" if not account.lost else f"{account.lost} lost"
        late = f", recorded from seq {account.since} on" if account.since else ""
        lines.append(f"  {node}: sent {account.sent}, recorded {account.recorded}: {told}{late}")
    for node, clock in remote.items():
        lines.append(
            f"  {node}: clock {-clock.offset:+.6f} s from the launcher's, known to ±{clock.error * 1e6:.0f} µs"
        )
    return "\n".join(lines)


def _info(arguments: argparse.Namespace) -> int:
    from nodes.recording.accounts import accounts, clocks, overruns
    from nodes.recording.reader import Recording

    recording = Recording(arguments.file)
    nodes, left_out = accounts(recording), overruns(recording)
    times = clocks(recording)
    remote = {node: clock for node, clock in times.items() if clock.error}
    figures = {
        "file": str(recording.path),
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
        "nodes": {
            node: {"sent": account.sent, "recorded": account.recorded, "lost": account.lost}
            for node, account in nodes.items()
        },
        "clocks": {node: {"offset_s": clock.offset, "error_s": clock.error} for node, clock in times.items()},
        "overruns": left_out,
        "recovered": recording.recovered,
        "complete": recording.complete,
        "cut": recording.cut,
        "manifest": recording.manifest,
    }
    answer(arguments.json, figures, _info_text(recording, nodes, left_out, remote))
    return 0


def _play(arguments: argparse.Namespace) -> int:
    import time

    import zmq

    from messages.transport.sockets import Publisher, new_context
    from nodes.recording.play import play
    from nodes.recording.reader import Recording

    if not arguments.endpoint.startswith(_LOCAL):
        raise UsageError(
            f"--endpoint {arguments.endpoint}: only {', '.join(_LOCAL)}...; a recording is not sent abroad"
        )
    recording = Recording(arguments.file)
    counts: dict[str, int] = {}
    context = new_context()
    try:
        publisher = Publisher(context, arguments.endpoint)
    except (ValueError, zmq.ZMQError) as error:
        context.term()
        raise UsageError(f"--endpoint: {error}") from error
    try:
        print(f"publishing on {arguments.endpoint}; Ctrl-C ends", file=sys.stderr, flush=True)
        while arguments.wait and not publisher.listeners():
            time.sleep(0.01)
        for entry in play(recording, publisher, rate=arguments.rate, topics=arguments.topics):
            counts[entry.topic] = counts.get(entry.topic, 0) + 1
    except KeyboardInterrupt:
        print(file=sys.stderr)
    finally:
        publisher.close()
        context.term()
    pace = "without a pause" if math.isinf(arguments.rate) else f"at {arguments.rate:g} times the original pace"
    told = "\n".join(f"  {topic}: {count}" for topic, count in counts.items())
    answer(arguments.json, {"published": counts}, f"published {pace}:\n{told}")
    return 0


def _recover(arguments: argparse.Namespace) -> int:
    from nodes.recording.recover import recover

    out = _free(arguments.out or arguments.file.with_suffix(".recovered.mcap"), arguments.force)
    saved = recover(arguments.file, out, overwrite=arguments.force)
    lines = [f"{out}: {sum(saved.messages.values())} messages saved"]
    lines += [f"  {topic}: {count}" for topic, count in saved.messages.items()]
    lines += saved.problems or ["the recording was complete and sound: nothing was lost"]
    figures = {
        "out": str(out),
        "messages": saved.messages,
        "problems": saved.problems,
        "recovered": bool(saved.problems),
    }
    answer(arguments.json, figures, "\n".join(lines))
    return 0


def _export(arguments: argparse.Namespace) -> int:
    from nodes.recording.export import export_csv, export_npz
    from nodes.recording.reader import Recording

    source: Path = arguments.file
    recording = Recording(source)
    if arguments.format == "csv":
        out = _free(arguments.out or source.with_name(f"{source.stem}_csv"), arguments.force)
        files = export_csv(recording, out, overwrite=arguments.force)
    else:
        out = _free(arguments.out or source.with_suffix(".npz"), arguments.force)
        files = [export_npz(recording, out, overwrite=arguments.force)]
    answer(arguments.json, {"files": [str(file) for file in files]}, "\n".join(map(str, files)))
    return 0


def _plot(arguments: argparse.Namespace) -> int:
    from nodes.recording.plot import plot
    from nodes.recording.reader import Recording

    out = _free(arguments.out or arguments.file.with_suffix(".png"), arguments.force)
    plot(Recording(arguments.file), out, overwrite=arguments.force)
    answer(arguments.json, {"plot": str(out)}, str(out))
    return 0
