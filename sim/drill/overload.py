"""Overload: run more chains beside the drilled one than the machine carries, for a while."""

from __future__ import annotations

import contextlib
import json
import tempfile
from collections.abc import Sequence
from pathlib import Path

from messages.types import DeviceState
from sim.drill.drill import Fault, fault_of
from sim.measure.haptic_commands import COMPILE_TIMEOUT, start_command
from sim.measure.rig import Rig

CHAINS = 12  # interpreted chains; two processors carry about eight at 500 Hz
SECONDS = 2.0
# Limit of the share of lost ticks: sharing processors loses some, a collapse all.
LOST_LIMIT = 0.5


class Overload:
    """A launch of many chains beside the drilled one."""

    def strike(self, rig: Rig) -> None:
        """Run the other launch to its end."""
        included = [
            {"launch": "floor_drop", "namespace": f"c{i}", "without": ["logger"]}
            for i in range(CHAINS)
        ]
        with contextlib.ExitStack() as held:
            folder = Path(
                held.enter_context(
                    tempfile.TemporaryDirectory(prefix="haptic-overload-")
                )
            )
            path = folder / "many.yaml"
            path.write_text(
                json.dumps({"summary": f"{CHAINS} chains", "include": included}),
                encoding="utf-8",
            )
            words = (
                str(path),
                f"run.duration:={SECONDS}",
                "--tick",
                "plain",
                "--json",
                "--no-plot",
            )
            output = held.enter_context(open(folder / "output.txt", "wb"))
            start_command(
                "launch",
                *words,
                cwd=folder,
                env=rig.environment,
                stdout=output,
                stderr=output,
            ).wait(COMPILE_TIMEOUT)

    def judge(self, states: Sequence[DeviceState]) -> list[str]:
        """Return a violation if too many ticks were lost."""
        if len(states) < 2:
            return ["no state of the driver since the strike"]
        ticks = states[-1].seq - states[0].seq
        first = states[0]
        last = states[-1]
        lost = (last.missed - first.missed + last.overruns - first.overruns) / max(
            ticks, 1
        )
        return (
            [f"{lost:.0%} of the ticks lost, limit {LOST_LIMIT:.0%}"]
            if lost > LOST_LIMIT
            else []
        )


def faults() -> list[Fault]:
    """Return the fault of this module."""
    made = Overload()
    return [
        fault_of(
            made, "overload", f"{CHAINS} more chains for {SECONDS:g} s", made.strike
        )
    ]
