"""End a running launch as Ctrl-C does: force to zero first, then the nodes in order, recordings complete."""

import argparse
import contextlib
import os
import signal
import time

from messages.errors import RefusedError, UsageError
from nodes.cli.ask import chosen_run
from nodes.cli.main import add_json, answer
from nodes.launcher.runs import STOPPED, alive, place_of, runs, write_end

# longest end of a launch [s]: a driver comes down from its largest force, a recorder writes what it
# holds
TIMEOUT = 60.0


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        "run_name",
        nargs="?",
        metavar="RUN",
        help="run or scenario (default: $HAPTIC_RUN, or the only one)",
    )
    parser.add_argument("--all", "-a", action="store_true", help="end all launches of this user")
    add_json(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Run the verb."""
    if arguments.all and arguments.run_name:
        raise UsageError(f"stop: --all and {arguments.run_name} at once; choose one")
    ending = list(runs().values()) if arguments.all else [chosen_run(arguments)]
    for one in ending:
        # It may have ended by itself this moment, or its disk be full: then nobody reads why it
        # ends.
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
