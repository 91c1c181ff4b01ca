"""Stop a running launch as Ctrl-C does: force to zero, then nodes, recordings complete."""

import argparse
import contextlib
import os
import signal
import time

from messages.errors import RefusedError, UsageError
from nodes.cli.ask import chosen_run
from nodes.cli.main import add_json, answer
from nodes.launcher.run_end import STOPPED, write_end
from nodes.launcher.runs import alive, place_of, runs

# Time limit of a launch's end: the driver's ramp to zero, and the recorder's queue [s].
TIMEOUT = 60.0


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        "run_name",
        nargs="?",
        metavar="RUN",
        help="run or scenario (default: $HAPTIC_RUN, or the only one)",
    )
    parser.add_argument(
        "--all", "-a", action="store_true", help="stop all launches of this user"
    )
    add_json(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Run the verb."""
    if arguments.all and arguments.run_name:
        raise UsageError(f"stop: --all together with {arguments.run_name}; choose one")
    ending = list(runs().values()) if arguments.all else [chosen_run(arguments)]
    for one in ending:
        # It may just have ended by itself, or the disk may be full: the reason is then not stored.
        with contextlib.suppress(OSError):
            write_end(place_of(one.run), STOPPED)
        with contextlib.suppress(ProcessLookupError):
            os.kill(one.launcher, signal.SIGINT)
    deadline = time.monotonic() + TIMEOUT
    for one in ending:
        while alive(one.launcher):
            if time.monotonic() > deadline:
                raise RefusedError(
                    f"{one.run}: its launcher, process {one.launcher}, has not ended within"
                    f" {TIMEOUT:g} s"
                )
            time.sleep(0.02)
    names = [one.run for one in ending]
    return answer(
        arguments.json,
        {"stopped": names},
        "\n".join(f"{name}: ended" for name in names) or "nothing is running",
    )
