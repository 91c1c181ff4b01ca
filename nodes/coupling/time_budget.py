"""A law's time budget: measures what the law used itself, not what the machine took.

On a shared machine a thread may lose its core for milliseconds. A law overruns if it computed for
longer than its budget, or took longer because it slept; preemption is neither. Time stolen by a
virtual machine's host counts as computed, though, and a wait for another thread of the interpreter
as sleep, so a single overrun may be the machine's; a second one within a second counts as the
law's.
"""

from __future__ import annotations

import math
import resource
import time

FORGIVEN = 1.0  # how long one overrun is remembered [s]


class Budget:
    """Measures one call per tick against a budget [s]; infinite: no measurement."""

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds
        self._wall = self._cpu = 0.0
        self._slept = 0
        self._before = -math.inf

    def start(self) -> None:
        """Start measuring."""
        self._slept = resource.getrusage(resource.RUSAGE_THREAD).ru_nvcsw
        self._cpu = time.thread_time()
        self._wall = time.monotonic()

    def overrun(self, excused: float = 0.0) -> str:
        """Return why the call since `start` overran, or an empty string.

        `excused` is time that the law may have waited for other threads of its process [s].
        """
        wall = time.monotonic() - self._wall
        if wall <= self.seconds:
            return ""
        cpu = time.thread_time() - self._cpu
        if cpu > self.seconds:
            return (
                f"computed for {cpu * 1e6:.0f} µs, budget {self.seconds * 1e6:.0f} µs"
            )
        if (
            wall - excused > self.seconds
            and resource.getrusage(resource.RUSAGE_THREAD).ru_nvcsw > self._slept
        ):
            return (
                f"slept: took {wall * 1e6:.0f} µs, budget {self.seconds * 1e6:.0f} µs"
            )
        return ""

    def again(self, now: float) -> bool:
        """Record an overrun at a loop time [s]. Return whether it is the second in `FORGIVEN`."""
        before = self._before
        self._before = now
        return now - before <= FORGIVEN
