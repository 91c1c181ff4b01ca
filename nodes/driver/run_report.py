"""A driver's reports: progress, summary of its run, and notes of its rules."""

from __future__ import annotations

from collections import deque
from typing import Any, Final

from nodes.driver.device import Device, DeviceLimits
from nodes.driver.force_words import Noted, take_notes
from nodes.driver.limits import Limits
from nodes.driver.motion import Ending, endings
from nodes.driver.response_times import ResponseTimes
from nodes.driver.state import LIMITED, REFUSED, SAFETY, DriverState

# changes of state in the summary of a run; all are on the driver's event topic
REASONS: Final = 8


class DriverReport:
    """The report of one driver."""

    def __init__(self, state: DriverState) -> None:
        self._state = state
        self.responses = ResponseTimes(state)  # its response times
        self.first = self.last = 0.0  # times of its first and last tick [s]
        # its first tick, and the ticks of the soft stop
        self.first_seq = self.soft_stop_ticks = 0
        self.complete = False  # whether it reached its last tick
        self.own_guard = False
        self._overruled: tuple[str, ...] = ()
        self._limits = DeviceLimits()
        self._changes: deque[Noted] = deque(maxlen=REASONS)

    def begin(self, device: Device, limits: Limits, own_guard: bool) -> None:
        """Record the limits of the run, and whether the launch file itself has a guard."""
        self._limits = device.limits
        self._overruled = limits.overruled
        self.own_guard = own_guard

    def count_soft_stop(self, ticks: int) -> None:
        """Record that the soft stop has taken so many ticks."""
        self.soft_stop_ticks = ticks

    def notes(self) -> list[Noted]:
        """Return the notes of the rules since the last call; changes of state enter the summary."""
        notes = take_notes(self._state)
        self._changes.extend(note for note in notes if note.is_change)
        return notes

    def progress(self, ticks: int) -> dict[str, Any]:
        """Return the data of the launcher's status line."""
        s = self._state
        return {
            "tick": s.ticks,
            "ticks": ticks,
            "position_m": list(s.position),
            "force_n": list(s.force),
            "safety": SAFETY[s.safety],
            "missed": s.missed,
            "overruns": s.overruns,
            "recent_s": self.responses.recent,
            "answered": self.responses.count,
        }

    def safety(self) -> dict[str, Any]:
        """Return a summary of the safety."""
        s = self._state
        return {
            "state": SAFETY[s.safety],
            "entered": {
                name: times
                for name, times in zip(SAFETY, s.entered, strict=True)
                if times
            },
            "refused": dict(zip(REFUSED, s.refused_for, strict=True)),
            "limited": dict(zip(LIMITED, s.limited_by, strict=True)),
            "reasons": [note.reason for note in self._changes],
            "changes": [_change(note) for note in self._changes],
            "told": list(self._overruled),
        }

    def summary(self) -> dict[str, Any]:
        """Return a summary of the run."""
        s = self._state
        span = self.last - self.first
        ends = endings(s)
        guard = {"lowered": s.lowered, "raised": s.raised, "highest_j": s.guard_highest}
        return {
            "complete": self.complete,
            "ticks": s.ticks,
            "missed": s.missed,
            "overruns": s.overruns,
            "answered": self.responses.count,
            "forces_refused": sum(s.refused_for),
            "safety": {**self.safety(), "soft_stop_ticks": self.soft_stop_ticks},
            "rate_hz": (s.asked - self.first_seq) / span if span > 0.0 else 0.0,
            "response_us": self.responses.summary_us(),
            "age_ticks_max": s.oldest_age,
            "energy_j": s.energy,
            "energy_max_j": s.highest,
            "latency_s": self._limits.latency,
            "guard": guard if s.guard_on else None,
            "final": {
                "position_m": list(s.position),
                "force_n": list(s.force),
                **{
                    name: list(values)
                    for name, values in zip(
                        Ending._fields, zip(*ends, strict=True), strict=True
                    )
                },
            },
        }


def _change(note: Noted) -> dict[str, Any]:
    """Return a change of state as data: states by name, and the numbers of its event."""
    names = {end: SAFETY[int(note.data[end])] for end in ("before", "after")}
    return {"kind": note.kind, **note.data, **names, "reason": note.reason}
