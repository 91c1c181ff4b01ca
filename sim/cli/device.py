"""List, check, free and identify devices: mass, damping, friction, delay and encoder, each with a 95 % interval."""

from __future__ import annotations

import argparse
import json
import os
import subprocess
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from messages.errors import RefusedError
from nodes.cli.ask import add_run, chosen_run, sub_verb
from nodes.cli.quantities import SECONDS, declare, number, positive
from nodes.laws.parse import parse_law
from sim.cli.answers import add_answer, given, report
from sim.measure.stopwatch import say

if TYPE_CHECKING:
    from sim.identify.borrowed import PushedLaunch
    from sim.identify.identified import Identified
    from sim.identify.push import Pushed


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the sub-verbs."""
    sub = parser.add_subparsers(
        dest="chosen", metavar="list|info|check|free|recentre|presets|identify", required=True
    )
    listed = sub.add_parser("list", help="which devices can be driven from here")
    add_answer(listed, _list, files=False)
    for name, run, text in (
        (
            "info",
            _info,
            "Connect to a device with forces off; print what it is and which force it can give.",
        ),
        (
            "check",
            _check,
            (
                "Check a device by hand: noise, rate, axes without a force, then a first force in"
                " steps, each asked for."
            ),
        ),
        (
            "free",
            _free,
            (
                "Name the process that holds a device; where there is none, switch its forces off"
                " and release it."
            ),
        ),
    ):
        one = sub.add_parser(name, help=text, description=text)
        one.add_argument("kind", help="kind of node that drives it: haptic device list")
        one.add_argument(
            "parameters",
            nargs="*",
            metavar="name:=value",
            help="of its driver: touch.library:=/opt/libHD.so",
        )
        add_answer(one, run, files=False)
        if name == "info":
            declare(one, rate=500.0, delay=1.0, gain=3.0)
    centred = sub_verb(
        sub,
        "recentre",
        _recentre,
        "Put the device of a running launch into the middle of its scene, wherever its handle is.",
    )
    centred.add_argument(
        "driver", nargs="?", default="driver", help="node that drives it (default: %(default)s)"
    )
    known = sub.add_parser(
        "presets", help="known values of real devices, with their sources: device:=touch_x"
    )
    add_answer(known, _presets, files=False)
    text = "Push the device of a running launch (or of a scenario, started for it) and identify it."
    own = sub.add_parser("identify", help=text, description=text)
    own.add_argument(
        "scenario",
        nargs="?",
        help="start this launch file; left out: the running launch, or identify",
    )
    own.add_argument(
        "assignments", nargs="*", metavar="name:=value", help="arguments of the launch file"
    )
    add_push(own)
    add_run(own)
    own.set_defaults(run=_identify)


def add_push(parser: argparse.ArgumentParser) -> None:
    """Declare how the device is pushed."""
    parser.add_argument(
        "--duration", type=SECONDS, default=8.0, help="of one push [s] (default: %(default)s)"
    )
    parser.add_argument(
        "--amplitude", type=positive, default=0.7, help="largest push [N] (default: %(default)s)"
    )
    parser.add_argument(
        "--reach",
        type=positive,
        default=0.03,
        help="how far it is pushed [m] (default: %(default)s)",
    )
    text = (
        "push at each of these distances from here, along every axis [m] (default: -0.02 0 0.02 of"
        " three axes, else 0)"
    )
    parser.add_argument("--places", type=number, nargs="+", metavar="OFFSET", help=text)
    text = (
        "the force that carries the device's weight [N] (default: what acts on it at rest, refused"
        " above --amplitude: it may be a hand's)"
    )
    parser.add_argument("--load", type=number, metavar="FORCE", help=text)
    hand = parser.add_mutually_exclusive_group()
    hand.add_argument(
        "--held", dest="held", action="store_true", default=None, help="a hand holds the device"
    )
    hand.add_argument(
        "--free", dest="held", action="store_false", help="no hand does (default: finds out)"
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("recordings"),
        help="directory of files (default: %(default)s)",
    )


def _list(arguments: argparse.Namespace) -> int:
    from sim.device_check.found import devices, text

    return report(arguments, {"devices": [asdict(kind) for kind in devices()]}, text())


def _info(arguments: argparse.Namespace) -> int:
    from sim.device_check.found import device_of
    from sim.device_check.info import info, text

    device = device_of(arguments.kind, arguments.parameters)
    found = info(device, arguments.rate, arguments.delay, arguments.gain)
    return report(arguments, found, f"{arguments.kind}: {device.TITLE}\n{text(found)}")


def _check(arguments: argparse.Namespace) -> int:
    from sim.device_check.check import check
    from sim.device_check.found import device_of

    found = check(device_of(arguments.kind, arguments.parameters), arguments.kind)
    return report(arguments, found, found["line"], held=found["passed"])


def _free(arguments: argparse.Namespace) -> int:
    from sim.device_check.found import device_of
    from sim.device_check.free import free

    device = device_of(arguments.kind, arguments.parameters)
    return report(
        arguments, free(device), f"{arguments.kind}: forces are off, and no process holds it"
    )


def _recentre(arguments: argparse.Namespace) -> int:
    from nodes.client.launches import ask, node_name

    run = chosen_run(arguments)
    found = ask(run, node_name(run, arguments.driver), "recentre")
    x, y, z = (f"{1e3 * value:+.1f}" for value in found["moved_m"])
    return report(
        arguments, found, f"the device is in the middle of the scene: moved by {x}, {y}, {z} mm"
    )


def _presets(arguments: argparse.Namespace) -> int:
    from sim.device.real_devices import figures, text

    return report(arguments, {"presets": figures()}, text())


def _identify(arguments: argparse.Namespace) -> int:
    from nodes.launcher.runs import runs
    from sim.identify.identified_text import figures, text
    from sim.identify.signals_once import interrupted_once

    if ":=" in (arguments.scenario or ""):
        arguments.assignments.insert(0, arguments.scenario)
        arguments.scenario = "identify"
    excitation(arguments)
    with interrupted_once() as signalled:
        try:
            if arguments.scenario is None and (arguments.run_name or runs()):
                found = identify_running(arguments, say)
            else:
                found = identify_scenario(
                    arguments, arguments.scenario or "identify", arguments.assignments
                )
        except KeyboardInterrupt:
            say("nothing was recorded: interrupted before the push began; law and surface are back")
            return 128 + (signalled() or 2)
    places = [
        {
            "recording": str(pushed.recording),
            "place_m": list(pushed.place),
            "stopped": pushed.reason,
            **figures(one),
        }
        for pushed, one in found
    ]
    lines = [
        f"at {', '.join(f'{x:.3g}' for x in pushed.place)} m, {pushed.recording}"
        f" ({pushed.reason})\n{text(one)}"
        for pushed, one in found
    ]
    held = all(one.mass.value is not None and not one.refuted for _, one in found)
    # The first push's figures at the top: one device, one place is the usual case.
    return report(arguments, {**places[0], "places": places}, lines, held=held)


def excitation(arguments: argparse.Namespace) -> dict[str, Any]:
    """Describe the excitation that was asked for."""
    law = {"kind": "excitation", **given(arguments, "duration", "amplitude", "reach")}
    parse_law(law, "excitation")
    return law


def identify_running(arguments: argparse.Namespace, tell: Any) -> list[tuple[Pushed, Identified]]:
    """Push the device of a running launch at each place, and identify it there on each axis."""
    from sim.identify.borrowed import PushedLaunch

    loop = PushedLaunch(chosen_run(arguments))
    law = excitation(arguments)
    arguments.out.mkdir(parents=True, exist_ok=True)
    places = arguments.places or ([-0.02, 0.0, 0.02] if len(loop.axes) == 3 else [0.0])
    here = [float(x) for x in loop.progress()["position_m"]]
    found: list[tuple[Pushed, Identified]] = []
    for n, offset in enumerate(places):
        centre = [x + offset if i in loop.axes else x for i, x in enumerate(here)]
        out = arguments.out / f"{loop.run.run}-push{n}-{os.getpid()}.mcap"
        pushed, axes = _pushed(loop, law, out, centre, tell, arguments)
        found += [(pushed, one) for one in axes]
        if pushed.reason != "done":
            break
    return found


def _pushed(
    loop: PushedLaunch,
    law: dict[str, Any],
    out: Path,
    centre: list[float],
    tell: Any,
    arguments: argparse.Namespace,
) -> tuple[Pushed, list[Identified]]:
    """Push and identify; again and longer when too many ticks were lost: on a busy machine, or by the recorder in lockstep."""
    from sim.identify.push import LONGEST, push

    # In lockstep ticks cost no time.
    longer = (1, 4, 16) if loop.run.nodes[loop.driver].pace == "lockstep" else (1, 3)
    for times in longer:
        out.unlink(missing_ok=True)
        duration = min(times * law["duration"], LONGEST)
        pushed = push(loop, {**law, "duration": duration}, out, centre, tell, arguments.load)
        try:
            with loop.standing():
                return pushed, _axes(loop, pushed, arguments.held)
        except RefusedError as error:
            if pushed.reason != "done" or times == longer[-1]:
                raise
            tell(f"{error}: pushing again, for longer ...")
    raise RefusedError(f"{out}: nothing was identified")


def _axes(loop: PushedLaunch, pushed: Pushed, held: bool | None) -> list[Identified]:
    from sim.identify.experiment import read
    from sim.identify.identify import identify

    try:
        return [identify(read(pushed.recording, "xyz"[i], pushed.ticks), held) for i in loop.axes]
    except ValueError as error:
        raise RefusedError(
            f"{pushed.recording}: {error} (the push ended: {pushed.reason})"
        ) from error


def identify_scenario(
    arguments: argparse.Namespace, scenario: str, assignments: list[str]
) -> list[tuple[Pushed, Identified]]:
    """Start a scenario that pushes by itself, and identify its recording."""
    from nodes.launcher import launch_file
    from sim.identify.experiment import read
    from sim.identify.identify import identify
    from sim.identify.push import Pushed
    from sim.measure.measured_launch import end, start_command

    launch = launch_file.read(scenario, launch_file.parse_assignments(assignments))
    words = list(assignments)
    if scenario == "identify":
        named = {word.partition(":=")[0] for word in assignments}
        law = given(arguments, "duration", "amplitude", "reach")
        words += [f"{name}:={value}" for name, value in law.items() if name not in named]
    process = start_command(
        "launch", scenario, *words, "--json", "--no-plot", stdout=subprocess.PIPE, text=True
    )
    try:
        out, _ = process.communicate()
    except KeyboardInterrupt:
        # It ends safely; what it recorded until then counts.
        end(process)
        out, _ = process.communicate()
    try:
        figures = json.loads(out.splitlines()[-1])
        recording = Path(figures["recording"])
    except (IndexError, KeyError, TypeError, json.JSONDecodeError) as error:
        raise RefusedError(
            f"haptic launch {scenario}: exit code {process.returncode}, no recording"
        ) from error
    pushed = Pushed(recording, (0.0, 0.0, 0.0), figures["exit_reason"])
    try:
        return [
            (pushed, identify(read(recording, axis), arguments.held)) for axis in launch.run.axes
        ]
    except ValueError as error:
        raise RefusedError(f"{recording}: {error}") from error
