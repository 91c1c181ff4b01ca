"""Start a scenario: haptic launch floor_drop stiffness:=1500 rate:=1000."""

import argparse
import json
import os
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec

from messages.errors import UsageError
from messages.transport.requests import ControlError
from nodes.base import realtime
from nodes.base.log_line import AS_JSON, LAUNCH, WARNS, LogLine
from nodes.base.printable import printable
from nodes.base.stderr_queue import drain_stderr, instead_of_stderr
from nodes.cli.debugging import Debugging
from nodes.cli.dispatch import refuse_unwritable
from nodes.cli.launch_report import note_cut, recordings_of, summarise, text_of
from nodes.cli.main import add_json, answer, coloured, heeding
from nodes.cli.page import PageAnnouncer, wants_another_run, with_view
from nodes.cli.status_line import StatusLine
from nodes.compiled.choose_tick import compile_later
from nodes.launcher import launch_file, scenario_files
from nodes.launcher.chain_load import OVERLOADED
from nodes.launcher.launch_spec import Launch
from nodes.launcher.run_end import STOPPED, ended_why
from nodes.launcher.runs import place_of
from nodes.launcher.supervisor import LaunchFailedError, Supervisor
from nodes.launcher.wiring import kernel_modules
from nodes.parameters.interface_words import interface
from nodes.parameters.store import ParameterError
from nodes.parameters.yaml_io import parse_yaml
from nodes.recording.logger import LoggerParameters, file_of
from nodes.ros2.added_bridges import MODES, with_ros2

_FLAGS = (
    (("--list",), "list the scenarios"),
    (("--show-args", "-s"), "show the arguments of a scenario"),
    (("--debug", "-d"), "print the resolved launch and each process"),
    (("--no-plot",), "do not draw the recording at the end"),
    (("--view",), "serve a page to see and touch the scene; print its URL first"),
)


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("scenario", nargs="?", help="name or path of a launch file")
    parser.add_argument(
        "assignments",
        nargs="*",
        metavar="name:=value",
        help="arguments of the launch file",
    )
    parser.add_argument(
        "--without",
        action="append",
        default=[],
        metavar="NODE",
        help="omit a node, e.g. logger",
    )
    parser.add_argument(
        "--params",
        action="append",
        default=[],
        type=Path,
        metavar="FILE",
        help=(
            "override node parameters with a file from haptic param dump or haptic study design"
        ),
    )
    parser.add_argument(
        "--tick",
        choices=("auto", "compiled", "plain"),
        help=(
            "run the loop's ticks compiled or in the interpreter (plain); same as tick:="
        ),
    )
    parser.add_argument(
        "--law",
        metavar="LAW",
        help="law to start with: a name, or a mapping {kind: ...}; same as law:=",
    )
    parser.add_argument(
        "--out-dir",
        type=Path,
        metavar="DIR",
        help="directory of recordings and plot (default: from the launch file)",
    )
    for names, text in _FLAGS:
        parser.add_argument(*names, action="store_true", help=text)
    parser.add_argument(
        "--ros2",
        choices=MODES,
        help="put each chain on the ROS 2 graph, to read only or to set parameters too",
    )
    add_json(parser)
    parser.set_defaults(run=run)


def _list() -> dict[str, Any]:
    found = {}
    for name, path in scenario_files.scenarios().items():
        summary, arguments = scenario_files.read_arguments(path)
        found[name] = {
            "summary": summary,
            "arguments": {key: value.default for key, value in arguments.items()},
        }
    return {"scenarios": found}


def _show_args(scenario: str) -> tuple[dict[str, Any], str]:
    path = scenario_files.find(scenario)
    summary, arguments = scenario_files.read_arguments(path)
    lines = [f"{path.stem}: {summary}"]
    figures = {}
    for name, argument in arguments.items():
        limits = [f"at least {argument.min:g}"] if argument.min is not None else []
        limits += [f"at most {argument.max:g}"] if argument.max is not None else []
        limits += [f"one of {', '.join(argument.choices)}"] if argument.choices else []
        unit = f" {argument.unit}" if argument.unit else ""
        bounds = f" ({'; '.join(limits)})" if limits else ""
        lines.append(f"  {name}:={argument.default}{unit}   {argument.help}{bounds}")
        figures[name] = {
            "default": argument.default,
            "unit": argument.unit,
            "help": argument.help,
        }
    return {"scenario": path.stem, "arguments": figures}, "\n".join(lines)


def run(arguments: argparse.Namespace) -> int:
    """Run the verb."""
    if arguments.list:
        figures = _list()
        lines = [
            f"{name:18} {entry['summary']}"
            for name, entry in figures["scenarios"].items()
        ]
        return answer(arguments.json, figures, "\n".join(lines))
    if arguments.scenario is None:
        raise UsageError("name a scenario; haptic launch --list shows them")
    launch: Launch | None = None
    try:
        if arguments.show_args:
            return answer(arguments.json, *_show_args(arguments.scenario))
        given = scenario_files.parse_assignments(arguments.assignments)
        if arguments.tick is not None:
            given["tick"] = arguments.tick
        if arguments.law is not None:
            given["law"] = parse_yaml(arguments.law, "law")
        launch = launch_file.without(
            launch_file.read(arguments.scenario, given, arguments.params),
            arguments.without,
        )
        if arguments.out_dir:
            launch = _into(launch, arguments.out_dir)
        if arguments.ros2:
            launch = with_ros2(launch, arguments.ros2)
        _check_places(launch)
        return _launch(with_view(launch) if arguments.view else launch, arguments)
    except ParameterError as error:
        text = str(error) if launch is None else launch.origins.located(error)
        raise UsageError(text) from error


def _places(launch: Launch) -> Iterator[tuple[str, Path]]:
    """Yield the name and the file of each local logger."""
    for name, spec in launch.nodes.items():
        if spec.kind == "logger" and not spec.host:
            yield (
                name,
                Path(
                    file_of(
                        spec.parameters.get("path", LoggerParameters().path),
                        "{run}",
                        name,
                    )
                ),
            )


def _check_places(launch: Launch) -> None:
    """Refuse, before the start, unwritable places and one file for two loggers."""
    taken: dict[Path, str] = {}
    for name, path in _places(launch):
        refuse_unwritable(path, interface.get().out_dir)
        if (other := taken.setdefault(path.absolute(), name)) != name:
            raise UsageError(
                f"{launch.scenario}: {other} and {name} both record to {path}; set another"
                f" nodes.{name}.parameters.path for one of them"
            )


def _into(launch: Launch, folder: Path) -> Launch:
    """Make all loggers of this machine write into `folder`."""
    nodes = dict(launch.nodes)
    for name, _ in _places(launch):
        # As written: its logger puts run and namespace into the name.
        written = Path(nodes[name].parameters.get("path", LoggerParameters().path))
        parameters = {**nodes[name].parameters, "path": str(folder / written.name)}
        nodes[name] = msgspec.structs.replace(nodes[name], parameters=parameters)
    return msgspec.structs.replace(launch, nodes=nodes)


def _plot(recording: str, say: Callable[[str], None]) -> str | None:
    """Draw a recording beside it; Ctrl-C ends only the drawing, even while libraries load."""
    from nodes.recording.plot import plot
    from nodes.recording.reader import Recording
    from nodes.recording.writer import RecordError

    picture = Path(recording).with_suffix(".png")
    try:
        plot(Recording(recording), picture, overwrite=True)
    except RecordError as error:
        say(f"no plot: {error}")
        return None
    return str(picture)


def _print(text: str) -> None:
    try:
        print(text, flush=True)
    except BrokenPipeError:
        # The reader is gone; the exit code still counts.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _launch(launch: Launch, arguments: argparse.Namespace) -> int:
    # A reader of the launcher's output may pause; supervision and Ctrl-C must not wait for it.
    instead_of_stderr()
    page = PageAnnouncer(arguments.json)
    while True:
        supervisor, code = _run_once(launch, arguments, page)
        recordings = [place + path for place, path in recordings_of(launch, supervisor)]
        if not wants_another_run(launch, supervisor, page, recordings):
            return code


def _run_once(
    launch: Launch, arguments: argparse.Namespace, page: PageAnnouncer
) -> tuple[Supervisor, int]:
    """Run a launch from start to end; return its supervisor and the exit code."""
    status = StatusLine(launch)

    def write(line: LogLine) -> None:
        status.clear()
        name = f"[{LAUNCH}]"
        text = str(line).replace(name, coloured(name, "dim", sys.stderr), 1)
        sys.stderr.write(f"{line.as_json() if AS_JSON else text}\n")

    def say(text: str) -> None:
        write(LogLine(text, LAUNCH))

    def warn(text: str) -> None:
        write(LogLine(text, LAUNCH, WARNS))

    debug = Debugging(launch, say) if arguments.debug else None

    def progress(supervisor: Supervisor) -> None:
        if debug is not None:
            debug(supervisor)
        page(supervisor)
        status(supervisor)

    supervisor = Supervisor(launch, say, warn, page.files())

    def on_signal(number: int) -> None:
        supervisor.interrupt(
            ended_why(str(place_of(supervisor.run))) or signal.Signals(number).name
        )

    with heeding(on_signal):
        try:
            supervisor.supervise(progress)
        except (LaunchFailedError, ControlError, OSError) as error:
            supervisor.failed = True
            supervisor.exit_reason = str(error)
            warn(str(error))
    status.clear()
    return supervisor, _end(launch, supervisor, arguments, page, say)


def _end(
    launch: Launch,
    supervisor: Supervisor,
    arguments: argparse.Namespace,
    page: PageAnnouncer,
    say: Callable[[str], None],
) -> int:
    """Print what came of a run, draw its recording, and return the exit code."""
    figures = summarise(launch, supervisor)
    note_cut(supervisor, figures["ticks"])
    overload = "" if supervisor.load is None else supervisor.load.text
    if not arguments.json:
        # Print before drawing, which takes a second.
        _print(printable(text_of(launch, figures, overload)))
    if launch.run.tick == "auto" and supervisor.tick == "plain" and figures["ticks"]:
        _compile_later(launch, supervisor, say)
    # A recording on another machine is drawn there, with haptic bag plot.
    here = [path for place, path in recordings_of(launch, supervisor) if not place]
    if here and not arguments.no_plot and figures["ticks"]:
        try:
            figures["plot"] = _plot(here[0], say)
        except KeyboardInterrupt:
            say(f"no plot: interrupted; haptic bag plot {here[0]} draws it")
    drain_stderr()
    page.drain()
    if arguments.json:
        _print(json.dumps(figures))
    elif figures["plot"]:
        _print(f"  plot      {figures['plot']}")
    return _exit_code(launch, supervisor)


def _compile_later(
    launch: Launch, supervisor: Supervisor, say: Callable[[str], None]
) -> None:
    """Compile the tick of the next launch in the background, off the loop's processors."""
    processors = {
        cpu
        for child in supervisor.children.values()
        for cpu in child.setup.scheduling.cpus
    }
    with realtime.off(processors):
        compile_later(kernel_modules(launch), say)


def _exit_code(launch: Launch, supervisor: Supervisor) -> int:
    if supervisor.failed or supervisor.failures:
        return 1
    if supervisor.load is not None and supervisor.load.cause == "chains":
        return OVERLOADED
    # launch/README.md lists the early ends. A run without an end of its own, such as a service,
    # ends normally by a signal.
    early = {STOPPED: 130, "SIGINT": 130, "SIGTERM": 143, "SIGHUP": 129}
    return early.get(supervisor.exit_reason, 0) if launch.run.ticks else 0
