"""What a driver has to say: events after the force, its figures, and that its device hangs."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import Any

import msgspec

from nodes.base.node import Node
from nodes.base.standstill import LastResort, Standstill, give_up
from nodes.driver.device import Device
from nodes.driver.ending import Ending
from nodes.driver.motion import Motion
from nodes.driver.passivity import PassivityGuard, PassivityParameters
from nodes.driver.response_times import ResponseTimes
from nodes.driver.safety import Safety
from nodes.parameters.store import ParameterError


class Answers(Node):
    """The part of a driver that is not the loop: `nodes.driver.node` makes what it speaks of."""

    _device: Device
    _axes: list[int]
    _safety: Safety
    _guard: PassivityGuard | None
    _guard_is_own: bool
    _motion: Motion
    _standstill: Standstill
    _last_resort: LastResort | None
    _responses: ResponseTimes
    _untold: deque[tuple[str, str]]
    _doing: tuple[str, float]
    _soft_stop_ticks: int
    _missed: int
    _overruns: int
    _oldest_age: int
    _first_seq: int
    _first_stamp: float
    _last_stamp: float
    _complete: bool

    def _guard_of(self, parameters: PassivityParameters | None) -> PassivityGuard | None:
        if parameters is None or parameters.guard != "on":
            return None
        return PassivityGuard(parameters, self.setup.period, self._axes)

    def prepare(self, parameters: Any) -> Callable[[int], Any]:
        """Prepare another guard, its account at zero: all of a driver that changes, where the launch file asked for none."""
        if msgspec.structs.replace(parameters, passivity=None) != msgspec.structs.replace(
            self.store.current, passivity=None
        ):
            raise ParameterError(
                f"{self.setup.name}: parameters of a {self.setup.kind} are fixed while it runs, all but passivity"
            )
        if self._guard_is_own:
            raise ParameterError(f"{self.setup.name}.passivity: the launch file's own guard is fixed while it runs")
        guard = self._guard_of(parameters.passivity)

        def apply(seq: int) -> dict[str, Any]:
            self._guard = guard
            return {"seq": seq}

        return apply

    def _tell_safety(self, kind: str, reason: str) -> None:
        """Take down what the safety has to say: the force comes first, words when the tick is done."""
        if kind.startswith("refused"):
            self.tell(kind, reason)
        else:
            self._untold.append((kind, reason))
            self.called = True

    def _tell_all(self) -> None:
        while self._untold:
            kind, reason = self._untold.popleft()
            # Every change of state is published, whatever else happened.
            self.tell(kind, reason, always=kind in ("safety", "stopped"))

    def between_ticks(self, seq: int) -> None:
        """Tell what happened, then do what every node does."""
        self._tell_all()
        super().between_ticks(seq)

    # -- a loop that stands still (control thread) -------------------------------------------------------------------

    def look_after(self) -> None:
        """End the process when the device hangs: nobody but the device itself can bring its force down then."""
        what, limit = self._doing
        self._wind(limit)
        if self._standstill.look((what, *self.counted(), self._soft_stop_ticks)) >= limit:
            hold = self._device.limits.hold
            lets_go = f"it lets go by itself after {hold:g} s" if math.isfinite(hold) else "it may hold its last force"
            give_up(self, f"the device hangs: no end of {what} within {limit:g} s; {lets_go}")

    def _begin(self, what: str, limit: float = math.inf) -> None:
        """Note what the loop's thread is at from now on, and how long it may take."""
        self._doing = (what, limit)
        self._wind(limit)

    def _wind(self, limit: float) -> None:
        if self._last_resort is not None:
            self._last_resort.wind(limit if math.isfinite(limit) else self._device.limits.opening)

    def operations(self) -> dict[str, Callable[..., Any]]:
        """Offer what the launcher's status line asks for."""
        limits = self._device.limits
        times = {"opening_s": limits.opening, "closing_s": limits.closing}
        return {"progress": self._progress, "device": lambda: times}

    def _progress(self) -> dict[str, Any]:
        figures = {
            "tick": self.ticks,
            "ticks": self.setup.ticks,
            "position_m": list(self._motion.position),
            "force_n": list(self._safety.force),
            "safety": self._safety.state,
            "missed": self._missed,
            "overruns": self._overruns,
            "recent_s": self._responses.recent.tobytes(),
            "answered": self._responses.count,
        }
        ahead = self.ticking()
        return figures if ahead is None else {**figures, **ahead.progress()}

    def report(self) -> dict[str, Any]:
        """Summarise the run."""
        span = self._last_stamp - self._first_stamp
        endings = self._motion.endings(self._safety.force)
        return {
            "complete": self._complete,
            "ticks": self.ticks,
            "missed": self._missed,
            "overruns": self._overruns,
            "answered": self._responses.count,
            "forces_refused": sum(self._safety.refused.values()),
            "safety": {**self._safety.summary(), "soft_stop_ticks": self._soft_stop_ticks},
            "rate_hz": (self.seq - self._first_seq) / span if span > 0.0 else 0.0,
            "response_us": self._responses.summary_us(),
            "age_ticks_max": self._oldest_age,
            "energy_j": self._motion.energy,
            "energy_max_j": self._motion.highest,
            "latency_s": self._device.limits.latency,
            "guard": self._guard.summary() if self._guard else None,
            "final": {
                "position_m": list(self._motion.position),
                "force_n": list(self._safety.force),
                **{name: list(values) for name, values in zip(Ending._fields, zip(*endings, strict=True), strict=True)},
            },
        }
