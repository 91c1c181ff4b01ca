"""Identify a device, design and predict a law, verify it up to its edge, and report."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from messages.errors import RefusedError
from nodes.client import launches
from sim.identify.pushing import identify_running
from sim.studies.device_options import refuse_taps
from sim.studies.result import StudyResult, plain
from sim.tune.tune_options import STEPS, TuneOptions

if TYPE_CHECKING:
    from sim.identify.identified import Identified
    from sim.tune.record import TuneRecord


@dataclass(frozen=True, repr=False)
class TuneResult(StudyResult):
    """Results of a tuning and its files."""

    record: TuneRecord  # what each step found
    files: dict[str, str]  # written files
    interrupted: int = 0

    @property
    def refused(self) -> str:
        """Return why a step was refused; else empty."""
        return self.record.refused

    @property
    def held(self) -> bool:
        """Return whether every step was done and the law holds, if one was tried."""
        return self.record.came_through() and not self.refused

    @property
    def answer(self) -> dict[str, Any]:
        """Return the figures by name."""
        return {**plain(self.record), "files": self.files}

    @property
    def text(self) -> str:
        """Return the text report."""
        from sim.tune.tuning_text import text

        return text(self.record, self.files)


def tune(options: TuneOptions) -> TuneResult:
    """Run the steps of a tuning; the device is left safe and results are written in all cases.

    The refusal of a step is part of the result; incompatible options raise UsageError.
    """
    refuse_taps(options.taps)
    options.excitation()
    options.out.mkdir(parents=True, exist_ok=True)
    from sim.identify.borrowed import PushedLaunch
    from sim.measure.haptic_commands import MeasurementError
    from sim.measure.interrupts import interrupted_once, undisturbed
    from sim.measure.measured_launch import launched
    from sim.tune.session import Tuning

    places = options.places or [0.0]
    run_name = options.run_name

    def identified() -> tuple[Path, str, Identified]:
        asked = replace(options, places=places, run_name=run_name)
        (pushed, found), *_ = identify_running(asked)
        return pushed.recording, pushed.reason, found

    steps = [name for name in STEPS if name in options.steps]
    tuning = Tuning(
        options,
        lambda: PushedLaunch(launches.find(run_name)),
        identified,
        "identify" in steps,
    )
    number, now = 0, ""
    with interrupted_once() as signalled, contextlib.ExitStack() as held:
        try:
            if options.scenario and {"identify", "apply", "verify"} & set(steps):
                options.say(f"starting {options.scenario} ...")
                words = (*options.assignments, "duration:=0")
                run_name = held.enter_context(launched(options.scenario, *words)).run
            for now in steps:
                options.say(f"{now} ...")
                tuning.do(now)
                tuning.keep()
            now = ""
        except KeyboardInterrupt:
            tuning.record.interrupted = now or "the start"
            number = signalled() or 2
        except (RefusedError, ValueError, MeasurementError) as error:
            tuning.record.refused = str(error)
        finally:
            with undisturbed():
                tuning.keep()
                # A lockstep loop would run on while the report is drawn.
                held.close()
                tuning.write()
    options.say("")
    return TuneResult(tuning.record, tuning.files, number)
