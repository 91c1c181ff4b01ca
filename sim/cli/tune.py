"""Tune a law for the device at hand: identify it, design, predict, try it from far below up to its edge, and report."""

from __future__ import annotations

import argparse
import contextlib
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from messages.errors import RefusedError, UsageError
from nodes.cli.ask import add_run, chosen_run
from nodes.cli.main import answer
from nodes.cli.quantities import between, declare, positive
from sim.cli.answers import given
from sim.cli.device import add_push, excitation, identify_running
from sim.measure.stopwatch import say
from sim.tune.session import STEPS, Options, Tuning

if TYPE_CHECKING:
    from sim.identify.identified import Identified


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        "scenario", nargs="?", help="start this launch file for it; left out: the running launch"
    )
    parser.add_argument(
        "assignments", nargs="*", metavar="name:=value", help="arguments of the launch file"
    )
    parser.add_argument(
        "--steps",
        nargs="+",
        choices=STEPS,
        default=list(STEPS),
        help="only these; what comes before is read from --out",
    )
    declare(parser, taps=4)
    parser.add_argument(
        "--spread",
        type=between(1.0, 100.0),
        default=1.25,
        help="factor the mass may be off by (default: %(default)s)",
    )
    parser.add_argument(
        "--radius",
        type=between(1e-3, 1.0),
        default=0.99,
        help="pole radius allowed (default: %(default)s)",
    )
    parser.add_argument(
        "--nyquist",
        type=positive,
        help="|H(-1)| allowed [N/m] (default: what friction quiets, 2 f_c/Δ, 1000 to 10000)",
    )
    parser.add_argument(
        "--land",
        action=argparse.BooleanOptionalAction,
        default=True,
        help=(
            "demand that every drop on a floor settles too; without it a law is stiffer, and may"
            " not survive a landing"
        ),
    )
    parser.add_argument(
        "--refuted",
        action="store_true",
        help="design even if the recording refutes the model of the device",
    )
    parser.add_argument(
        "--rearm",
        action="store_true",
        help=(
            "re-enable forces after a trial that stopped the driver; use only while standing at the"
            " device (virtual: always)"
        ),
    )
    add_push(parser)
    add_run(parser)
    parser.set_defaults(run=run, out=Path("tuning"))


def run(arguments: argparse.Namespace) -> int:
    """Go through the steps; whatever happens, leave the device safe and write what is known."""
    if not 1 <= arguments.taps <= 12:
        raise UsageError(
            f"--taps {arguments.taps}: between 1 and 12; the search is over each of them"
        )
    excitation(arguments)
    arguments.out.mkdir(parents=True, exist_ok=True)
    from sim.identify.borrowed import PushedLaunch
    from sim.identify.signals_once import interrupted_once, undisturbed
    from sim.measure.measured_launch import MeasurementError, launched

    arguments.places = arguments.places or [0.0]

    def identified() -> tuple[Path, str, Identified]:
        (pushed, found), *_ = identify_running(arguments, say)
        return pushed.recording, pushed.reason, found

    names = (
        "out",
        "taps",
        "spread",
        "radius",
        "nyquist",
        "land",
        "refuted",
        "amplitude",
        "load",
        "rearm",
    )
    options = Options(**given(arguments, *names), command=shlex.join(["haptic", *sys.argv[1:]]))
    steps = [name for name in STEPS if name in arguments.steps]
    tuning = Tuning(
        options, lambda: PushedLaunch(chosen_run(arguments)), identified, say, "identify" in steps
    )
    live = {"identify", "apply", "verify"} & set(steps)
    code, now = 0, ""
    with interrupted_once() as signalled, contextlib.ExitStack() as held:
        try:
            if live and arguments.scenario:
                say(f"starting {arguments.scenario} ...")
                words = (*arguments.assignments, "duration:=0")
                arguments.run_name = held.enter_context(launched(arguments.scenario, *words)).run
            for now in steps:
                say(f"{now} ...")
                tuning.do(now)
                tuning.keep()
            now = ""
        except KeyboardInterrupt:
            tuning.record["interrupted"] = now or "the start"
            code = 128 + (signalled() or 2)
        except (RefusedError, ValueError, MeasurementError) as error:
            tuning.record["refused"] = str(error)
            code = 1
        finally:
            with undisturbed():
                tuning.keep()
                # A loop in lockstep would go on beside whoever draws.
                held.close()
                tuning.write()
    from sim.tune.tuning_text import text

    say("")
    answer(
        arguments.json, tuning.record | {"files": tuning.files}, text(tuning.record, tuning.files)
    )
    return code or (0 if tuning.came_through else 1)
