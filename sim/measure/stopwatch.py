"""Reliable timing: interleaved, repeated, with spread and the name of the machine.

A shared machine drifts while candidates are timed one after another, so every round runs all of
them, in rotating order; the result is the median over the rounds with its quartiles.
"""

import os
import platform
import statistics
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

from nodes.base.kept_line import columns, is_smart, rewrite


@dataclass(frozen=True)
class Timing:
    """Time per unit of work."""

    median: float  # median over the rounds [s]
    # Lower and upper quartile [s].
    low: float
    high: float
    rounds: int  # number of rounds


class Progress:
    """Progress bar on standard error; without a terminal, a line per tenth."""

    def __init__(
        self, total: int, stream: TextIO | None = None, after: float = 0.0
    ) -> None:
        self._total = max(1, total)
        self._from = time.monotonic() + after
        self._stream = sys.stderr if stream is None else stream
        self._terminal = is_smart(self._stream)
        self._done = 0
        self._shown = -1

    def step(self, what: str, count: int = 1) -> None:
        """Advance by `count`."""
        self._done = min(self._total, self._done + count)
        if time.monotonic() < self._from:
            return
        tenths = 10 * self._done // self._total
        if self._terminal:
            bar = "#" * (3 * tenths) + "." * (30 - 3 * tenths)
            percent = 100 * self._done // self._total
            rewrite(
                self._stream, f"[{bar}] {percent:3d} %  {what}"[: columns(self._stream)]
            )
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
    step: Callable[[str], None] = lambda _: None,
) -> dict[str, Timing]:
    """Time several jobs against each other, in rotating order."""
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
        step(f"timing, round {k + 1} of {rounds}")
    return {name: _summary(values) for name, values in seconds.items()}


def _summary(values: list[float]) -> Timing:
    ordered = sorted(values)
    last = len(values) - 1
    return Timing(
        statistics.median(ordered),
        ordered[last // 4],
        ordered[last - last // 4],
        len(ordered),
    )


def machine() -> dict[str, Any]:
    """Return a description of the machine that figures were measured on."""
    from importlib.metadata import version

    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    named = (
        line.partition(":")[2].strip()
        for line in lines
        if line.startswith("model name")
    )
    return {
        "cpu": next(named, platform.processor() or platform.machine()),
        "cores": os.cpu_count() or 1,
        "system": f"{platform.system()} {platform.release()}",
        "python": platform.python_version(),
        "numpy": version("numpy"),
        "numba": version("numba"),
        "load_1min": round(os.getloadavg()[0], 2)
        if hasattr(os, "getloadavg")
        else None,
    }


SILENT = 5.0  # shortest time between progress lines in a pipe [s]
_last = [-SILENT]


def say(words: str) -> None:
    """Print progress on standard error; an empty text ends the line."""
    if is_smart(sys.stderr):
        rewrite(sys.stderr, words[: columns(sys.stderr)])
    elif words and (words.endswith("...") or time.monotonic() - _last[0] >= SILENT):
        _last[0] = time.monotonic()
        print(words, file=sys.stderr, flush=True)
