"""Identify the device of a recording: mass, damping, friction, delay, encoder, each with a 95 % interval."""

from dataclasses import dataclass
from pathlib import Path

from messages.errors import RefusedError, UsageError
from nodes.parameters.options import Options, argument, option
from nodes.parameters.quantities import whole
from nodes.recording.writer import RecordError
from sim.studies.result import Answer, answered


@dataclass(frozen=True, kw_only=True)
class IdentifyOptions(Options):
    """Options of `identify`."""

    recording: Path = argument(type=Path, help="of a launch, best of haptic launch identify")
    axis: str | None = option(
        choices=("x", "y", "z"), help="which axis (default: the one that was pushed hardest)"
    )
    held: bool | None = option(
        off="--free",
        action="store_true",
        help="a hand held the device",
        off_help="no hand did (default: finds out)",
    )
    window: int = option(
        default=100, type=whole(20, 5000), help="length of a window [ticks] (default: %(default)s)"
    )


def identify(options: IdentifyOptions) -> Answer:
    """Identify."""
    from sim.identify.experiment import read
    from sim.identify.identified_text import figures, text
    from sim.identify.identify import identify

    try:
        experiment = read(options.recording, options.axis)
    except (RecordError, OSError) as error:
        raise UsageError(str(error)) from error
    except ValueError as error:
        raise RefusedError(str(error)) from error
    try:
        found = identify(experiment, options.held, options.window)
    except ValueError as error:
        raise RefusedError(f"{options.recording}: {error}") from error
    held = found.mass.value is not None and not found.refuted
    return answered({"recording": str(options.recording), **figures(found)}, text(found), held=held)
