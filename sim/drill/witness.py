"""What a missed tick came from, by measurement: who of the chain waited for a processor, computed, or was stolen its time.

The kernel counts for each thread how long it ran and how long it was ready to run but did not (``schedstat``), and for the
processors what the machine below took from them (``steal``). A witness beside the launch reads both a hundred times a second. A
stall of the loop is then compared with what was counted while it lasted.
"""

from __future__ import annotations

import contextlib
import threading
import time
from bisect import bisect_left, bisect_right
from collections.abc import Mapping
from pathlib import Path

PERIOD = 0.01
"""Time between two looks [s]."""

SHARE = 0.25
"""From this share of a tick's period on, waiting or stolen time explains why an answer came late."""

UNEXPLAINED = "unexplained"


class Witness:
    """Reads the kernel's counts until it is closed."""

    def __init__(self, period: float) -> None:
        self._period = period
        # Process number of each node of the chain; a fault that starts a new one changes it.
        self.pids: dict[str, int] = {}
        self._found: dict[int, dict[int, str]] = {}
        self._times: list[float] = []
        self._looks: list[dict[tuple[str, int, str], float]] = []
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="witness", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._ending.wait(PERIOD):
            look: dict[tuple[str, int, str], float] = {}
            for name, pid in list(self.pids.items()):
                for thread, whose in self._threads(pid).items():
                    try:
                        ran, waited = (
                            Path(f"/proc/{pid}/task/{thread}/schedstat").read_text(encoding="ascii").split()[:2]
                        )
                    except OSError:
                        continue
                    look[name, thread, f"{whose}waited for its processor"] = int(waited) * 1e-9
                    look[name, thread, f"{whose}computed"] = int(ran) * 1e-9
            with open("/proc/stat", encoding="ascii") as stat:
                steal = float(stat.readline().split()[8])
            look["the machine", 0, "was stolen time"] = steal * 0.01
            self._times.append(time.monotonic())
            self._looks.append(look)

    def _threads(self, pid: int) -> dict[int, str]:
        """Find the threads that a message of the loop passes through: the loop's own, and ZeroMQ's first."""
        if pid not in self._found:
            found = {pid: ""}
            for path in Path(f"/proc/{pid}/task").glob("*/comm"):
                # One that has ended meanwhile carries nothing.
                with contextlib.suppress(OSError):
                    if path.read_text(encoding="ascii").strip() == "ZMQbg/IO/0":
                        found[int(path.parent.name)] = "'s sockets "
            self._found[pid] = found
        return self._found[pid]

    def close(self) -> None:
        """Stop looking."""
        self._ending.set()
        self._thread.join()

    def cause(self, begun: float, ended: float) -> str:
        """Find what was counted during a stall."""
        first = max(bisect_left(self._times, begun) - 1, 0)
        last = min(bisect_right(self._times, ended), len(self._times) - 1)
        if not 0 <= first < last:
            return UNEXPLAINED
        return largest(self._looks[first], self._looks[last], self._times[last] - self._times[first], self._period)


def largest(
    before: Mapping[tuple[str, int, str], float],
    after: Mapping[tuple[str, int, str], float],
    seconds: float,
    period: float,
) -> str:
    """Find what explains a stall best."""
    found: list[tuple[float, str]] = []
    for key, value in after.items():
        if key in before:
            grown = value - before[key] - (0.5 * seconds if key[2].endswith("computed") else 0.0)
            found.append((grown, f"{key[0]} {key[2]}".replace(" '", "'")))
    most, what = max(found, default=(0.0, ""))
    return what if most >= SHARE * period else UNEXPLAINED
