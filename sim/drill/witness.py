"""A witness of missed ticks: what held up a chain, by the kernel's own counters.

The kernel counts for each thread how long it ran and how long it was ready but did not run
(``schedstat``), and the time stolen from the processors by the host (``steal``). A witness reads
both a hundred times a second; a stall is compared with the counts during it.
"""

from __future__ import annotations

import contextlib
import threading
import time
from bisect import bisect_left, bisect_right
from collections.abc import Mapping
from pathlib import Path

WITNESS_PERIOD = 0.01  # time between two readings [s]
# Waiting or stolen time that explains a late answer [periods].
SHARE = 0.25
UNEXPLAINED = "unexplained"


class Witness:
    """Reads the kernel's counters until it is closed."""

    def __init__(self, period: float) -> None:
        self._period = period
        # Process number of each node of the chain; updated after respawns.
        self.pids: dict[str, int] = {}
        self._found: dict[int, dict[int, str]] = {}
        self._times: list[float] = []
        self._looks: list[dict[tuple[str, int, str], float]] = []
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="witness", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._ending.wait(WITNESS_PERIOD):
            look: dict[tuple[str, int, str], float] = {}
            for name, pid in list(self.pids.items()):
                for thread, whose in self._threads(pid).items():
                    try:
                        ran, waited = (
                            Path(f"/proc/{pid}/task/{thread}/schedstat")
                            .read_text(encoding="ascii")
                            .split()[:2]
                        )
                    except OSError:
                        continue
                    look[name, thread, f"{whose}waited for its processor"] = (
                        int(waited) * 1e-9
                    )
                    look[name, thread, f"{whose}computed"] = int(ran) * 1e-9
            with open("/proc/stat", encoding="ascii") as stat:
                steal = float(stat.readline().split()[8])
            look["the machine", 0, "was stolen time"] = steal * 0.01
            self._times.append(time.monotonic())
            self._looks.append(look)

    def _threads(self, pid: int) -> dict[int, str]:
        """Return the threads that loop messages pass through: the main one and ZeroMQ's first."""
        if pid not in self._found:
            found = {pid: ""}
            for path in Path(f"/proc/{pid}/task").glob("*/comm"):
                # The thread may have ended.
                with contextlib.suppress(OSError):
                    if path.read_text(encoding="ascii").strip() == "ZMQbg/IO/0":
                        found[int(path.parent.name)] = "'s sockets "
            self._found[pid] = found
        return self._found[pid]

    def close(self) -> None:
        """Stop reading."""
        self._ending.set()
        self._thread.join()

    def cause(self, begun: float, ended: float) -> str:
        """Return the cause of a stall from the counters during it."""
        first = max(bisect_left(self._times, begun) - 1, 0)
        last = min(bisect_right(self._times, ended), len(self._times) - 1)
        if not 0 <= first < last:
            return UNEXPLAINED
        return largest(
            self._looks[first],
            self._looks[last],
            self._times[last] - self._times[first],
            self._period,
        )


def largest(
    before: Mapping[tuple[str, int, str], float],
    after: Mapping[tuple[str, int, str], float],
    seconds: float,
    period: float,
) -> str:
    """Return the cause with the largest count, if it explains the stall."""
    found: list[tuple[float, str]] = []
    for key, value in after.items():
        if key in before:
            grown = (
                value
                - before[key]
                - (0.5 * seconds if key[2].endswith("computed") else 0.0)
            )
            found.append((grown, f"{key[0]} {key[2]}".replace(" '", "'")))
    longest, what = max(found, default=(0.0, ""))
    return what if longest >= SHARE * period else UNEXPLAINED
