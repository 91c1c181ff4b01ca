"""Timing that can be believed: interleaved, repeated, with its spread, on a machine that is named.

A shared machine drifts while one candidate after another is timed, so every round runs all of them, in an order that
rotates; what is reported is the median over the rounds and the quartiles around it.
"""

from __future__ import annotations

import os
import platform
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

from nodes.base.kept_line import columns, is_smart, keep


@dataclass(frozen=True)
class Timing:
    """Time per unit of work."""

    median: float  # median over the rounds [s]
    # Lower and upper quartile [s].
    low: float
    high: float
    rounds: int  # how many rounds


class Progress:
    """A progress bar on standard error; a line for every tenth when that is not a terminal.

    `stream`: where to draw; standard error when left out.
    """

    def __init__(self, total: int, stream: TextIO | None = None, after: float = 0.0) -> None:
        self._total = max(1, total)
        self._from = time.monotonic() + after
        self._stream = sys.stderr if stream is None else stream
        self._terminal = is_smart(self._stream)
        self._done = 0
        self._shown = -1

    def step(self, what: str, count: int = 1) -> None:
        """Go on."""
        self._done = min(self._total, self._done + count)
        if time.monotonic() < self._from:
            return
        tenths = 10 * self._done // self._total
        if self._terminal:
            bar = "#" * (3 * tenths) + "." * (30 - 3 * tenths)
            percent = 100 * self._done // self._total
            keep(self._stream, f"[{bar}] {percent:3d} %  {what}"[: columns(self._stream)])
            if self._done == self._total:
                self._stream.write("\n")
                self._stream.flush()
        elif tenths != self._shown:
            self._stream.write(f"{10 * tenths} %  {what}\n")
            self._stream.flush()
        self._shown = tenths


def interleaved(
    jobs: Mapping[str, tuple[Callable[[], object], int]],
    rounds: int,
    step: Callable[[str], None] | None = None,
) -> dict[str, Timing]:
    """Time several jobs against each other."""
    names = list(jobs)
    seconds: dict[str, list[float]] = {name: [] for name in names}
    for name in names:
        jobs[name][0]()
    for k in range(rounds):
        first = k * max(1, len(names) // max(1, rounds)) % max(1, len(names))
        for name in names[first:] + names[:first]:
            run, units = jobs[name]
            start = time.perf_counter()
            run()
            seconds[name].append((time.perf_counter() - start) / units)
        if step is not None:
            step(f"timing, round {k + 1} of {rounds}")
    return {name: _summary(values) for name, values in seconds.items()}


def _summary(values: list[float]) -> Timing:
    ordered = sorted(values)
    last = len(ordered) - 1
    middle = 0.5 * (ordered[last // 2] + ordered[(last + 1) // 2])
    return Timing(middle, ordered[last // 4], ordered[last - last // 4], len(ordered))


def machine() -> dict[str, Any]:
    """Name the machine that figures were taken on."""
    from importlib.metadata import version

    cpu = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                cpu = line.partition(":")[2].strip()
                break
    return {
        "cpu": cpu,
        "cores": os.cpu_count() or 1,
        "system": f"{platform.system()} {platform.release()}",
        "python": platform.python_version(),
        "numpy": version("numpy"),
        "numba": version("numba"),
        "load_1min": round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None,
    }
