"""The end of nodes: SIGINT, then SIGTERM, then SIGKILL, each with the time it needs."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Sequence
from typing import Final

from nodes.base.hang_watchdog import CHECK_INTERVAL, HangWatchdog
from nodes.launcher.child import Child

# how long nodes have to end after each signal [s]
TIMEOUTS: Final = {signal.SIGINT: 3.0, signal.SIGTERM: 2.0, signal.SIGKILL: 2.0}
HURRY_TIMEOUT = 0.3  # the same for all but drivers, where the user asks twice [s]
# additional time to die for a process that the kernel does not hold: on a machine with thirty times
# more work than it can do, dying takes its time too [s]
DYING = 20.0
_INSISTENCE: Final = tuple(TIMEOUTS)


def end(
    group: Sequence[Child], warn: Callable[[str], None], is_hurried: Callable[[], bool]
) -> list[str]:
    """End nodes together.

    Returns
    -------
    list of str
        Why a process is left behind, for each that is.
    """
    for number in TIMEOUTS:
        left = [child for child in group if child.running]
        for child in left:
            if number != signal.SIGINT:
                warn(f"{child.setup.name}: does not end; {number.name}")
            # While its interpreter is being set up, a process answers SIGINT with a traceback,
            # SIGTERM with silence.
            asked = (
                number
                if child.ready
                else max(number, signal.SIGTERM, key=_INSISTENCE.index)
            )
            child.send(asked)
        if number == signal.SIGKILL:
            _await_death(left)
        else:
            _Wait(left, TIMEOUTS[number], warn, is_hurried).run()
    # The kernel holds on to what is left: a frozen control group, a file system that is gone.
    return [
        f"{child.setup.name}: process still there {TIMEOUTS[signal.SIGKILL]:g} s after SIGKILL;"
        " left behind"
        for child in group
        if child.running
    ]


def _await_death(left: Sequence[Child]) -> None:
    begun = time.monotonic()
    while running := [child for child in left if child.running]:
        granted = 0.0 if any(child.is_frozen for child in running) else DYING
        if time.monotonic() - begun > TIMEOUTS[signal.SIGKILL] + granted:
            return
        time.sleep(0.005)


class _Wait:
    """A wait for nodes that were asked to end.

    Time in which a node makes progress does not count, nor time in which others keep it from
    running.
    """

    def __init__(
        self,
        left: Sequence[Child],
        patience: float,
        warn: Callable[[str], None],
        is_hurried: Callable[[], bool],
    ) -> None:
        self._left, self._patience = left, patience
        self._warn, self._is_hurried = warn, is_hurried
        self._begun = time.monotonic()
        self._watched = {child.setup.name: HangWatchdog() for child in left}
        self._announced = False

    def run(self) -> None:
        """Wait until all have ended, or none gets on any more."""
        checked = self._begun
        while any(child.running for child in self._left):
            now = time.monotonic()
            if self._is_cut_short(now):
                return
            if now >= checked:
                checked = now + CHECK_INTERVAL
                stood = self._stood()
                granted = max((child.end_patience for child in self._left), default=0.0)
                if all(
                    seconds > self._patience + granted for seconds in stood.values()
                ):
                    return
                if now - self._begun > 0.5 * self._patience + granted:
                    self._announce(stood, 0.5 * (now - self._begun))
            time.sleep(0.005)

    def _is_cut_short(self, now: float) -> bool:
        """Return whether the user asked twice; a driver still gets its time."""
        drives = any(child.drives for child in self._left)
        return self._is_hurried() and not drives and now - self._begun > HURRY_TIMEOUT

    def _stood(self) -> dict[str, float]:
        """Return for how long each running node made no progress [s]."""
        return {
            name: watchdog.check(
                child.progress() if child.listens else 0, child.waited()
            )
            for child in self._left
            if child.running
            for name, watchdog in [(child.setup.name, self._watched[child.setup.name])]
        }

    def _announce(self, stood: dict[str, float], half: float) -> None:
        """Report once which nodes are still waited for, and why."""
        if self._announced:
            return
        for child in self._left:
            name = child.setup.name
            if name in stood and stood[name] < half:
                waits = child.waited() > half
                why = f"does not get its turn{burden()}" if waits else "still writing"
                self._warn(f"{name}: {why}; waited for (Ctrl-C again: not)")
                self._announced = True


def burden() -> str:
    """Return the load of an overloaded machine as text; empty for any other machine."""
    load = os.getloadavg()[0]
    processors = os.cpu_count() or 1
    return (
        f"; this machine is busy: load {load:.0f} on {processors} processors"
        if load > 2 * processors
        else ""
    )
