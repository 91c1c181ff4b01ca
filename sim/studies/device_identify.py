"""`haptic device identify`: push the device of a launch and identify it at each place."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from sim.identify.pushing import PushOptions, identify_running, identify_scenario
from sim.measure.interrupts import interrupted_once
from sim.studies.result import Findings, StudyResult

if TYPE_CHECKING:
    from sim.identify.identified import Identified
    from sim.identify.push import Pushed


@dataclass(frozen=True, repr=False)
class IdentifiedPlaces(StudyResult):
    """Identified device at each place and axis of a push."""

    places: tuple[tuple[Pushed, Identified], ...]

    @property
    def held(self) -> bool:
        """Whether every mass is known and no recording refutes the model."""
        return all(
            one.mass.value is not None and not one.refuted for _, one in self.places
        )

    @property
    def answer(self) -> dict[str, Any]:
        """Figures by name, those of the first push at the top level."""
        from sim.identify.identified_text import figures

        places = [
            {
                "recording": str(pushed.recording),
                "place_m": list(pushed.place),
                "stopped": pushed.reason,
                **figures(one),
            }
            for pushed, one in self.places
        ]
        return {**places[0], "places": places}

    @property
    def text(self) -> str:
        """Text for the terminal."""
        from sim.identify.identified_text import text

        return "\n".join(
            f"at {', '.join(f'{x:.3g}' for x in pushed.place)} m, {pushed.recording}"
            f" ({pushed.reason})\n{text(one)}"
            for pushed, one in self.places
        )


def device_identify(options: PushOptions) -> StudyResult:
    """Identify the device of a running launch, or of a scenario started for it, by pushes.

    Parameters
    ----------
    options : PushOptions
        The launch, and how the device is pushed.

    Returns
    -------
    IdentifiedPlaces or Findings
        The device at each place; without figures if it was interrupted before the push began.

    Raises
    ------
    messages.errors.RefusedError
        If nothing was recorded, or the recording identifies nothing.
    """
    from nodes.launcher.runs import runs

    if ":=" in (options.scenario or ""):
        words = [str(options.scenario), *options.assignments]
        options = replace(options, scenario="identify", assignments=words)
    options.excitation()
    with interrupted_once() as signalled:
        try:
            if options.scenario is None and (options.run_name or runs()):
                found = identify_running(options)
            else:
                scenario = options.scenario or "identify"
                found = identify_scenario(options, scenario, options.assignments)
        except KeyboardInterrupt:
            why = (
                "nothing was recorded: interrupted before the push began;"
                " law and surface are back"
            )
            options.say(why)
            return Findings(lines=[why], held=False, interrupted=signalled() or 2)
    return IdentifiedPlaces(tuple(found))
