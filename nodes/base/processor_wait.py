"""Time for which a process waited for a processor, which must not count as a hang."""

import contextlib
import time
from pathlib import Path


class ProcessorWait:
    """Time for which a process was ready to run but did not, since the first check.

    The kernel counts it for each thread (``schedstat``), and adds it up when the thread runs. A
    thread that has not run since the last check is recognised by its state: ready to run, and no
    progress. A process that is stopped, frozen, or waits for something other than a processor is
    not delayed by others.
    """

    def __init__(self) -> None:
        self._updated = time.monotonic()
        self._threads: dict[str, tuple[int, int]] = {}
        self.seconds = 0.0

    def update(self, pid: int) -> float:
        """Update and return the total [s], by the thread that waited longest since last time."""
        now = time.monotonic()
        passed = now - self._updated
        self._updated = now
        seen: dict[str, tuple[int, int]] = {}
        most = 0.0
        for path in Path(f"/proc/{pid}/task").glob("[0-9]*"):
            # a thread that has ended waits for nothing
            with contextlib.suppress(OSError):
                ran, waited = map(
                    int, (path / "schedstat").read_text(encoding="ascii").split()[:2]
                )
                seen[path.name] = ran, waited
                before = self._threads.get(path.name)
                if before == (ran, waited) and state_of(path) == "R":
                    most = passed
                elif before is not None:
                    most = max(most, (waited - before[1]) * 1e-9)
        self._threads = seen
        # what is added up late was counted by the state before
        self.seconds += min(most, passed)
        return self.seconds


def state_of(path: Path) -> str:
    """Return the kernel's state letter of a process or thread, from its folder in /proc."""
    return (
        (path / "stat")
        .read_text(encoding="ascii", errors="replace")
        .rsplit(")", 1)[1]
        .split()[0]
    )
