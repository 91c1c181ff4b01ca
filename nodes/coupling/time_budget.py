"""A law's time budget: what it used itself, not what the machine took from it.

On a shared machine a thread may lose its core for milliseconds through no fault of its own. A law
overruns when it computed for longer than its budget, or when it took longer because it went to
sleep; being preempted is neither. Time that the host of a virtual machine takes counts as computed,
though, and a wait for another thread of the interpreter as sleep: one overrun alone is the
machine's, a second one within a second the law's.
"""

from __future__ import annotations

import math
import resource
import time

FORGIVEN = 1.0  # how long one overrun alone is remembered [s]


class Budget:
    """Watches one call per tick, which may take so many seconds; infinite for no watch."""

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds
        self._wall = self._cpu = 0.0
        self._slept = 0
        self._before = -math.inf

    def start(self) -> None:
        """Begin to watch."""
        self._slept = resource.getrusage(resource.RUSAGE_THREAD).ru_nvcsw
        self._cpu = time.thread_time()
        self._wall = time.monotonic()

    def overrun(self, excused: float = 0.0) -> str:
        """Judge what has passed since `start`, without what the law may have waited for others of its process [s]."""
        wall = time.monotonic() - self._wall
        if wall <= self.seconds:
            return ""
        cpu = time.thread_time() - self._cpu
        if cpu > self.seconds:
            return f"computed for {cpu * 1e6:.0f} µs, budget {self.seconds * 1e6:.0f} µs"
        if (
            wall - excused > self.seconds
            and resource.getrusage(resource.RUSAGE_THREAD).ru_nvcsw > self._slept
        ):
            return f"slept: took {wall * 1e6:.0f} µs, budget {self.seconds * 1e6:.0f} µs"
        return ""

    def again(self, now: float) -> bool:
        """Note an overrun at a time of the loop [s]; whether it is the second one within `FORGIVEN`."""
        before, self._before = self._before, now
        return now - before <= FORGIVEN
