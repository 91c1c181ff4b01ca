"""Identify the device of a recording: mass, damping, friction, delay, encoder, each with a 95 % interval."""

import argparse
from pathlib import Path

from messages.errors import RefusedError, UsageError
from nodes.cli.quantities import whole
from nodes.recording.writer import RecordError
from sim.cli.answers import add_answer, report


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("recording", type=Path, help="of a launch, best of haptic launch identify")
    parser.add_argument(
        "--axis",
        choices=("x", "y", "z"),
        help="which axis (default: the one that was pushed hardest)",
    )
    hand = parser.add_mutually_exclusive_group()
    hand.add_argument(
        "--held", dest="held", action="store_true", default=None, help="a hand held the device"
    )
    hand.add_argument(
        "--free", dest="held", action="store_false", help="no hand did (default: finds out)"
    )
    parser.add_argument(
        "--window",
        type=whole(20, 5000),
        default=100,
        help="length of a window [ticks] (default: %(default)s)",
    )
    add_answer(parser, run, files=False)


def run(arguments: argparse.Namespace) -> int:
    """Identify."""
    from sim.identify.experiment import read
    from sim.identify.identified_text import figures, text
    from sim.identify.identify import identify

    try:
        experiment = read(arguments.recording, arguments.axis)
    except (RecordError, OSError) as error:
        raise UsageError(str(error)) from error
    except ValueError as error:
        raise RefusedError(str(error)) from error
    try:
        found = identify(experiment, arguments.held, arguments.window)
    except ValueError as error:
        raise RefusedError(f"{arguments.recording}: {error}") from error
    held = found.mass.value is not None and not found.refuted
    return report(
        arguments, {"recording": str(arguments.recording), **figures(found)}, text(found), held=held
    )
