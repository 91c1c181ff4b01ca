"""Record, inspect, play back, cut, repair, export and draw recordings."""

import argparse
import math
import os
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

from messages.errors import UsageError
from nodes.cli.bag_arguments import (
    add_formats,
    add_out,
    add_patterns,
    add_play,
    add_plot,
    add_record,
    add_span,
    add_topics,
    chosen_topics,
    counted,
    free_file,
    opened,
    span_of,
)
from nodes.cli.bag_import import add_import, run_import
from nodes.cli.bag_info import show_info
from nodes.cli.bag_play import play_recording
from nodes.cli.main import add_json, answer, complain, heeding
from nodes.recording.reader import Recording
from nodes.recording.writer import RecordError

OWN = ("record", "info", "play", "cut", "filter", "recover", "export", "import", "plot")


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the sub-verbs."""
    verbs: dict[str, tuple[Callable[[argparse.Namespace], int], str]] = {
        "record": (
            _record,
            "Record a running launch into an MCAP file, until it ends or Ctrl-C.",
        ),
        "info": (
            show_info,
            "Show a recording's topics, message counts, gaps in seq and losses.",
        ),
        "play": (
            play_recording,
            "Publish a recording at its original pace, for PlotJuggler or a node.",
        ),
        "cut": (_extract, "Copy a part of a recording into a new one."),
        "filter": (_extract, "Copy some topics of a recording into a new one."),
        "recover": (
            _recover,
            "Copy everything sound in a cut or damaged recording into a complete one.",
        ),
        "export": (
            _export,
            "Write a recording as tables: one row per tick, and the parameters beside them.",
        ),
        "import": (
            run_import,
            "Write a table of another program (CSV, NPZ, …) as a recording.",
        ),
        "plot": (
            _plot,
            "Draw recordings: position, force, energy, response time; several as an overlay.",
        ),
    }
    sub = parser.add_subparsers(dest="chosen", metavar="|".join(OWN), required=True)
    for name, (run, text) in verbs.items():
        own = sub.add_parser(name, help=text, description=text)
        own.set_defaults(run=partial(_checked, run))
        add_json(own)
        for declare in _ARGUMENTS[name]:
            declare(own)


def _add_file(own: argparse.ArgumentParser) -> None:
    own.add_argument("file", type=Path)


def _add_all_topics(own: argparse.ArgumentParser) -> None:
    own.set_defaults(topics=[])


_ARGUMENTS: dict[str, tuple[Callable[[argparse.ArgumentParser], None], ...]] = {
    "record": (add_record,),
    "info": (_add_file,),
    "play": (add_play,),
    "cut": (_add_file, _add_all_topics, add_span, add_patterns, add_out),
    "filter": (add_topics, add_span, add_patterns, add_out),
    "recover": (_add_file, add_out),
    "export": (_add_file, add_formats, add_out),
    "import": (add_import,),
    "plot": (add_plot, add_span, add_out),
}


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
        topics = (
            chosen_topics(run.endpoints(), arguments) if patterns else arguments.topics
        )
        # The process number gives each of several recorders beside one launch its own file.
        out = free_file(
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


def _extract(arguments: argparse.Namespace) -> int:
    from nodes.recording.recover import extract

    recording = Recording(arguments.file)
    start, stop = span_of(arguments.start, arguments.stop)
    # Topics of other programs are copied too.
    known = [*recording.topics, *recording.foreign]
    for topic in arguments.topics:
        if topic not in known:
            raise UsageError(
                f"{arguments.file}: no topic {topic!r}; there are {', '.join(known)}"
            )
    topics = chosen_topics(known, arguments)
    out = free_file(
        arguments.out or arguments.file.with_suffix(f".{arguments.chosen}.mcap"),
        arguments.force,
    )
    counts = extract(recording, out, topics, start, stop, overwrite=arguments.force)
    return answer(
        arguments.json,
        {"out": str(out), "messages": counts},
        f"{out}:\n{counted(counts)}",
    )


def _recover(arguments: argparse.Namespace) -> int:
    from nodes.recording.recover import recover

    out = free_file(
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
    out = free_file(
        arguments.out or source.with_name(f"{source.stem}{ending}"), arguments.force
    )
    recording = opened(source)
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
    span_of(start := arguments.start, stop := arguments.stop)
    alone = len(files) == 1 and not arguments.xy
    ending = "" if alone else "_xy" if arguments.xy else "_overlay"
    out = free_file(
        arguments.out or files[0].with_name(f"{files[0].stem}{ending}.png"),
        arguments.force,
    )
    recordings = [opened(file) for file in files]
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
