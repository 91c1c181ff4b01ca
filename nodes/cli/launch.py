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
from messages.transport.endpoints import is_remote
from messages.transport.requests import ControlError
from nodes.base import realtime
from nodes.base.printable import printable
from nodes.base.setup import Setup
from nodes.base.stderr_queue import drain_stderr, instead_of_stderr
from nodes.cli.debugging import Debugging
from nodes.cli.dispatch import refuse_unwritable
from nodes.cli.main import add_json, answer, coloured, heeding
from nodes.cli.page import PageAnnouncer, with_view
from nodes.cli.status_line import StatusLine
from nodes.compiled.choose_tick import compile_later
from nodes.launcher import launch_file
from nodes.launcher.chain_load import OVERLOADED
from nodes.launcher.launch_spec import Launch
from nodes.launcher.runs import STOPPED, ended_why, place_of
from nodes.launcher.supervisor import LaunchFailedError, Supervisor
from nodes.launcher.wiring import kernel_modules
from nodes.parameters.store import ParameterError
from nodes.parameters.yaml_io import parse_yaml
from nodes.recording.logger import LoggerParameters, file_of
from nodes.recording.writer import Ended, write_ended


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("scenario", nargs="?", help="name or path of a launch file")
    parser.add_argument(
        "assignments",
        nargs="*",
        metavar="name:=value",
        help="arguments of the launch file",
    )
    parser.add_argument("--list", action="store_true", help="list the scenarios")
    parser.add_argument(
        "--show-args",
        "-s",
        action="store_true",
        help="show the arguments of a scenario",
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
    parser.add_argument(
        "--debug",
        "-d",
        action="store_true",
        help="print the resolved launch and each process",
    )
    parser.add_argument(
        "--no-plot", action="store_true", help="do not draw the recording at the end"
    )
    parser.add_argument(
        "--view",
        action="store_true",
        help="serve a page to see and touch the scene; print its URL first",
    )
    add_json(parser)
    parser.set_defaults(run=run)


def _list() -> dict[str, Any]:
    found = {}
    for name, path in launch_file.scenarios().items():
        summary, arguments = launch_file.read_arguments(path)
        found[name] = {
            "summary": summary,
            "arguments": {key: value.default for key, value in arguments.items()},
        }
    return {"scenarios": found}


def _show_args(scenario: str) -> tuple[dict[str, Any], str]:
    path = launch_file.find(scenario)
    summary, arguments = launch_file.read_arguments(path)
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


def _recordings(launch: Launch, supervisor: Supervisor) -> list[tuple[str, str]]:
    """Return host (``host:``, empty for this machine) and path of each recording, as for scp."""
    found = []
    for name, child in supervisor.children.items():
        # A killed logger leaves no report, but a file.
        path = supervisor.reports.get(name, {}).get("recording") or _path_of(
            child.setup, supervisor.run
        )
        if path:
            host = launch.nodes[name].host
            place = f"[{host}]:" if ":" in host else f"{host}:"
            found.append((place if host and is_remote(f"tcp://{place}1") else "", path))
    return found


def _path_of(setup: Setup, run: str) -> str:
    """Return the existing file that a local logger records to; else an empty string."""
    if setup.kind != "logger" or setup.control.startswith("tcp://"):
        return ""
    path = file_of(
        msgspec.convert(setup.parameters, LoggerParameters).path, run, setup.name
    )
    return path if os.path.exists(path) else ""


def _note_cut(supervisor: Supervisor, ticks: int) -> None:
    """Write the run's number of ticks beside each recording that its logger did not finish."""
    for child in supervisor.children.values():
        path = _path_of(child.setup, supervisor.run) if child.ended_badly else ""
        if path:
            write_ended(Path(path), Ended(ticks, child.end))


def summarise(launch: Launch, supervisor: Supervisor) -> dict[str, Any]:
    """Collect the figures of a run from the reports of its nodes."""
    drivers = {
        name.rpartition("/")[0]: name
        for name, child in supervisor.children.items()
        if child.drives
    }
    chains = {
        chain: _of_chain(launch, chain, supervisor.reports.get(name, {}))
        for chain, name in drivers.items()
    }
    recordings = [place + path for place, path in _recordings(launch, supervisor)]
    return {
        "scenario": launch.scenario,
        "run": supervisor.run,
        # Of several chains the first; all are listed below.
        **next(iter(chains.values()), _of_chain(launch, "", {})),
        "tick": supervisor.tick,
        "tick_by_node": {
            name: tick
            for name, report in supervisor.reports.items()
            if (tick := report.get("tick"))
        },
        "ticks_compiled": {
            name: report.get("ticks_compiled", 0)
            for name, report in supervisor.reports.items()
        },
        "spent_us": {
            name: spent
            for name, report in supervisor.reports.items()
            if (spent := report.get("spent_us"))
        },
        "moved": {
            name: moved
            for name, report in supervisor.reports.items()
            if (moved := report.get("moved"))
        },
        "recording": recordings[0] if recordings else None,
        "recordings": recordings,
        "plot": None,
        "exit_reason": supervisor.exit_reason,
        "failures": supervisor.failures,
        "not_judged": supervisor.unjudged,
        "load": None
        if supervisor.load is None
        else msgspec.to_builtins(supervisor.load),
        "startup_s": round(supervisor.startup_s, 3),
        "nodes": {
            name: report["status"] for name, report in supervisor.reports.items()
        },
        **({"chains": chains} if len(chains) > 1 else {}),
    }


def _of_chain(launch: Launch, chain: str, driver: dict[str, Any]) -> dict[str, Any]:
    """Return the figures of one chain from its driver's report."""
    axes = launch.axes.get(chain) or launch.run.axes
    axis = "xyz".index(axes[0])
    single = len(axes) == 1
    final = driver.get("final", {})
    nothing = {
        "ticks": 0,
        "missed": 0,
        "overruns": 0,
        "rate_hz": 0.0,
        "response_us": {},
        "age_ticks_max": 0,
    }
    nothing |= {"energy_j": 0.0, "energy_max_j": 0.0, "guard": None, "safety": {}}
    return {key: driver.get(key, none) for key, none in nothing.items()} | {
        "final": {
            key: (final[key][axis] if single else final[key]) if key in final else None
            for key in (
                "position_m",
                "force_n",
                "motion",
                "swing_m",
                "frequency_hz",
                "velocity_m_per_s",
            )
        }
    }


def _safety_text(safety: dict[str, Any]) -> list[str]:
    """Return lines about the driver's safety actions; none if there were none."""
    counts = [
        f"{number} refused ({why})"
        for why, number in safety.get("refused", {}).items()
        if number
    ]
    counts += [
        f"{number} lowered ({which})"
        for which, number in safety.get("limited", {}).items()
        if number
    ]
    first = ("waiting", "active")  # happens in every run, so not shown
    changes = [
        one["reason"]
        for one in safety.get("changes", [])
        if (one["before"], one["after"]) != first
    ]
    lines = [f"  safety    forces {', '.join(counts)}"] if counts else []
    lines += [f"  safety    {text}" for text in (*safety.get("told", []), *changes)]
    return lines


def _ending(final: dict[str, Any], stopped: bool) -> str:
    """Return a line about the final motion: stopped, at rest, swinging, falling or moving."""
    motion = final["motion"]
    where = (
        f"position {final['position_m'] * 1e3:+.4f} mm, force {final['force_n']:+.4f} N"
    )
    swing = f"{final['swing_m'] * 1e3:.3g} mm"
    speed = f"{final['velocity_m_per_s']:+.3g} m/s"
    if stopped:
        return f"  stopped   {where}, {motion}: no force acts any more"
    if motion == "swinging":
        return (
            f"  swinging  {where}, {swing} to and fro at {final['frequency_hz']:.3g} Hz"
        )
    if motion == "falling":
        return f"  falling   {where}, {speed}: it touches nothing"
    return (
        f"  at rest   {where}"
        if motion == "at rest"
        else f"  moving    {where}, {speed}"
    )


def _text(launch: Launch, figures: dict[str, Any], overload: str = "") -> str:
    lines = [
        f"{launch.scenario}: {figures['exit_reason']} after {figures['ticks']} ticks"
    ]
    lines += [
        f"  failed    {failure}"
        for failure in figures["failures"]
        if failure != figures["exit_reason"]
    ]
    by_node = figures["tick_by_node"]
    if by_node:
        ticks = sorted(set(by_node.values()))
        shown = [
            f"{tick}: {', '.join(name for name in by_node if by_node[name] == tick)}"
            for tick in ticks
        ]
        lines.append(f"  tick      {'; '.join(shown) if len(ticks) > 1 else ticks[0]}")
    if overload:
        lines.append(f"  overload  {overload}")
    lines += [
        f"  stability not judged: {why}" for why in figures["not_judged"].values()
    ]
    for chain, own in figures.get("chains", {"": figures}).items():
        lines += [f" /{chain}"] if chain else []
        lines += _chain_text(own)
    lines += [
        f"  moved     shapes of {name} put {1e3 * moved['energy_j']:.3g} mJ into the device, at"
        f" most {moved['power_w']:.3g} W"
        for name, moved in figures["moved"].items()
    ]
    lines += [f"  recording {path}" for path in figures["recordings"]]
    return "\n".join(lines)


def _chain_text(figures: dict[str, Any]) -> list[str]:
    """Return lines about one chain."""
    response = figures["response_us"]
    lines = list[str]()
    if response and figures["ticks"]:
        lines = [
            (
                f"  rate      {figures['rate_hz']:.2f} Hz, missed {figures['missed']}, overruns"
                f" {figures['overruns']}, oldest force {figures['age_ticks_max']} ticks"
            ),
            (
                f"  response  p50 {response['p50']:.0f} µs, p99 {response['p99']:.0f} µs, "
                f"p99.9 {response['p999']:.0f} µs, max {response['max']:.0f} µs"
            ),
        ]
    if guard := figures["guard"]:
        lines.append(
            f"  guard     lowered {guard['lowered']} and raised {guard['raised']} forces; energy"
            f" owed: at most {guard['highest_j'] * 1e3:.4g} mJ"
        )
    lines += _safety_text(figures["safety"])
    final = figures["final"]
    if figures["ticks"] and isinstance(final["position_m"], float):
        lines.append(_ending(final, figures["safety"].get("state") == "stopped"))
    return lines


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
        given = launch_file.parse_assignments(arguments.assignments)
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
        refuse_unwritable(path, "--out-dir")
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
    status = StatusLine(launch)

    def say(text: str) -> None:
        status.clear()
        sys.stderr.write(f"{coloured('[launch]', 'dim', sys.stderr)} {text}\n")

    page = PageAnnouncer(arguments.json)
    debug = Debugging(launch, say) if arguments.debug else None

    def progress(supervisor: Supervisor) -> None:
        if debug is not None:
            debug(supervisor)
        page(supervisor)
        status(supervisor)

    supervisor = Supervisor(launch, say)

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
            say(str(error))
    status.clear()
    figures = summarise(launch, supervisor)
    _note_cut(supervisor, figures["ticks"])
    if not arguments.json:
        # Print before drawing, which takes a second.
        _print(
            printable(
                _text(
                    launch,
                    figures,
                    "" if supervisor.load is None else supervisor.load.text,
                )
            )
        )
    if launch.run.tick == "auto" and supervisor.tick == "plain" and figures["ticks"]:
        _compile_later(launch, supervisor, say)
    # A recording on another machine is drawn there, with haptic bag plot.
    here = [path for place, path in _recordings(launch, supervisor) if not place]
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
