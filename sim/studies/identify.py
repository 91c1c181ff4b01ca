"""Identify a recording's device: mass, damping, friction, delay, encoder, 95 % intervals."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from messages.errors import RefusedError, UsageError
from nodes.parameters.options import Options, argument, option
from nodes.parameters.quantities import whole
from nodes.recording.writer import RecordError
from sim.studies.result import StudyResult

if TYPE_CHECKING:
    from sim.identify.identified import Identified


@dataclass(frozen=True, kw_only=True)
class IdentifyOptions(Options):
    """Options of `identify`."""

    recording: Path = argument(
        type=Path, help="of a launch, best of haptic launch identify"
    )
    axis: str | None = option(
        choices=("x", "y", "z"),
        help="which axis (default: the one that was pushed hardest)",
    )
    held: bool | None = option(
        off="--free",
        action="store_true",
        help="a hand held the device",
        off_help="no hand did (default: finds out)",
    )
    window: int = option(
        default=100, type=whole(20, 5000), help="length of a window [ticks]"
    )


@dataclass(frozen=True, repr=False)
class IdentifiedRecording(StudyResult):
    """Identified device of a recording, and whether the recording supports the model."""

    recording: Path
    found: Identified

    @property
    def held(self) -> bool:
        """Whether the mass is known and nothing refutes the model."""
        return self.found.mass.value is not None and not self.found.refuted

    @property
    def answer(self) -> dict[str, Any]:
        """Figures by name."""
        from sim.identify.identified_text import figures

        return {"recording": str(self.recording), **figures(self.found)}

    @property
    def text(self) -> str:
        """Text for the terminal."""
        from sim.identify.identified_text import text

        return text(self.found)


def identify(options: IdentifyOptions) -> IdentifiedRecording:
    """Identify the device of a recording.

    Parameters
    ----------
    options : IdentifyOptions
        The recording, its axis, whether a hand held the device, and the length of a window [ticks].

    Returns
    -------
    IdentifiedRecording
        Mass [kg], damping [N s/m], friction [N], delay [ticks] and encoder [m], each with its 95 %
        interval.

    Raises
    ------
    messages.errors.UsageError
        If the file is not a recording.
    messages.errors.RefusedError
        If the recording identifies nothing.
    """
    from sim.identify.experiment import read
    from sim.identify.identify import identify as found_in

    try:
        experiment = read(options.recording, options.axis)
    except (RecordError, OSError) as error:
        raise UsageError(str(error)) from error
    except ValueError as error:
        raise RefusedError(str(error)) from error
    try:
        found = found_in(experiment, options.held, options.window)
    except ValueError as error:
        raise RefusedError(f"{options.recording}: {error}") from error
    return IdentifiedRecording(options.recording, found)
