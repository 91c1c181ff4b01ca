"""Push and identify a device, in a running launch or in a scenario started for it."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from messages.errors import RefusedError
from nodes.client import launches
from nodes.laws.parse import parse_law
from nodes.parameters.options import Options, argument, option
from nodes.parameters.quantities import SECONDS, number, positive

if TYPE_CHECKING:
    from sim.identify.borrowed import PushedLaunch
    from sim.identify.identified import Identified
    from sim.identify.push import Pushed


def quiet(what: str) -> None:
    """Ignore progress messages."""
    del what


@dataclass(frozen=True, kw_only=True)
class PushOptions(Options):
    """How a device is pushed, and in which launch."""

    scenario: str | None = argument(
        default=None,
        help="start this launch file; left out: the running launch, or identify",
    )
    assignments: list[str] = argument(
        default=[],
        nargs="*",
        metavar="name:=value",
        help="arguments of the launch file",
    )
    duration: float = option(type=SECONDS, default=8.0, help="of one push [s]")
    amplitude: float = option(type=positive, default=0.7, help="largest push [N]")
    reach: float = option(type=positive, default=0.03, help="how far it is pushed [m]")
    places: list[float] | None = option(
        type=number,
        nargs="+",
        metavar="OFFSET",
        help=(
            "push at each of these distances from here, along every axis [m] (default: -0.02 0"
            " 0.02 of three axes, else 0)"
        ),
    )
    load: float | None = option(
        type=number,
        metavar="FORCE",
        help=(
            "the force that carries the device's weight [N] (default: what acts on it at rest,"
            " refused above --amplitude: it may be a hand's)"
        ),
    )
    held: bool | None = option(
        off="--free",
        action="store_true",
        help="a hand holds the device",
        off_help="no hand does (default: finds out)",
    )
    out: Path = option(type=Path, default=Path("recordings"), help="directory of files")
    run_name: str | None = option(
        "--run",
        metavar="NAME",
        help=(
            "which launch, when several are running, or NAME/NAMESPACE for one of its chains"
            " (default: $HAPTIC_RUN)"
        ),
    )
    # called with progress messages
    say: Callable[[str], None] = field(default=quiet, repr=False, compare=False)

    def excitation(self) -> dict[str, Any]:
        """Return the excitation; raise LawRefusedError beyond its limits."""
        law = {"kind": "excitation", **self.chosen("duration", "amplitude", "reach")}
        parse_law(law, "excitation")
        return law


def identify_running(options: PushOptions) -> list[tuple[Pushed, Identified]]:
    """Push the device of a running launch at each place and identify it on each axis."""
    from sim.identify.borrowed import PushedLaunch

    loop = PushedLaunch(launches.find(options.run_name))
    law = options.excitation()
    options.out.mkdir(parents=True, exist_ok=True)
    places = options.places or ([-0.02, 0.0, 0.02] if len(loop.axes) == 3 else [0.0])
    here = [float(x) for x in loop.progress()["position_m"]]
    found: list[tuple[Pushed, Identified]] = []
    for n, offset in enumerate(places):
        centre = [x + offset if i in loop.axes else x for i, x in enumerate(here)]
        out = options.out / f"{loop.run.run}-push{n}-{os.getpid()}.mcap"
        pushed, axes = _pushed(loop, law, out, centre, options)
        found += [(pushed, one) for one in axes]
        if pushed.reason != "done":
            break
    return found


def _pushed(
    loop: PushedLaunch,
    law: dict[str, Any],
    out: Path,
    centre: list[float],
    options: PushOptions,
) -> tuple[Pushed, list[Identified]]:
    """Push and identify; repeat with a longer push if too many ticks were lost.

    Ticks are lost on a busy machine, or by the recorder in lockstep.
    """
    from sim.identify.push import MAX_DURATION, push

    # In lockstep ticks cost no time.
    longer = (1, 4, 16) if loop.run.nodes[loop.driver].pace == "lockstep" else (1, 3)
    for times in longer:
        out.unlink(missing_ok=True)
        duration = min(times * law["duration"], MAX_DURATION)
        asked = {**law, "duration": duration}
        pushed = push(loop, asked, out, centre, options.say, options.load)
        try:
            with loop.standing():
                return pushed, _axes(loop, pushed, options.held)
        except RefusedError as error:
            if pushed.reason != "done" or times == longer[-1]:
                raise
            options.say(f"{error}: pushing again, for longer ...")
    raise RefusedError(f"{out}: nothing was identified")


def _axes(loop: PushedLaunch, pushed: Pushed, held: bool | None) -> list[Identified]:
    from sim.identify.experiment import read
    from sim.identify.identify import identify

    try:
        return [
            identify(read(pushed.recording, "xyz"[i], pushed.ticks), held)
            for i in loop.axes
        ]
    except ValueError as error:
        raise RefusedError(
            f"{pushed.recording}: {error} (the push ended: {pushed.reason})"
        ) from error


def identify_scenario(
    options: PushOptions, scenario: str, assignments: list[str]
) -> list[tuple[Pushed, Identified]]:
    """Start a scenario that pushes by itself and identify its recording."""
    from nodes.launcher import launch_file, scenario_files
    from sim.identify.experiment import read
    from sim.identify.identify import identify
    from sim.identify.push import Pushed
    from sim.measure.started_launch import StartedLaunch

    launch = launch_file.read(scenario, scenario_files.parse_assignments(assignments))
    words = list(assignments)
    if scenario == "identify":
        named = {word.partition(":=")[0] for word in assignments}
        law = options.chosen("duration", "amplitude", "reach")
        words += [
            f"{name}:={value}" for name, value in law.items() if name not in named
        ]
    with StartedLaunch(scenario, *words) as started:
        try:
            started.wait()
        except KeyboardInterrupt:
            # It ends safely; its recording up to then is used.
            started.interrupt()
        figures, failure = started.figures, started.failure()
    if "recording" not in figures or figures["recording"] is None:
        raise RefusedError(f"{failure}, no recording")
    recording = Path(figures["recording"])
    pushed = Pushed(recording, (0.0, 0.0, 0.0), figures["exit_reason"])
    try:
        return [
            (pushed, identify(read(recording, axis), options.held))
            for axis in launch.run.axes
        ]
    except ValueError as error:
        raise RefusedError(f"{recording}: {error}") from error
