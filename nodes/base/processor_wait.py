"""How long a process was kept from running: on a busy machine, time in which nothing happens says nothing about it."""

import contextlib
import time
from pathlib import Path


class ProcessorWait:
    """How long a process has been kept from running by others, since the first look: time not to be held against it.

    The kernel counts for each thread how long it was ready to run but did not (``schedstat``), and
    adds it up when the thread gets its turn. One that has not had its turn since the last look is
    known by its state: ready to run, and nothing done. A process that is stopped, frozen, or waits
    for something else than a processor is not kept from running by anybody.
    """

    def __init__(self) -> None:
        self._looked = time.monotonic()
        self._threads: dict[str, tuple[int, int]] = {}
        self.seconds = 0.0

    def look(self, pid: int) -> float:
        """Look once more [s]: of its threads the one counts that has waited most since the last look."""
        now = time.monotonic()
        passed, self._looked = now - self._looked, now
        seen: dict[str, tuple[int, int]] = {}
        most = 0.0
        for path in Path(f"/proc/{pid}/task").glob("[0-9]*"):
            # One that has ended meanwhile waits for nothing.
            with contextlib.suppress(OSError):
                ran, waited = map(int, (path / "schedstat").read_text(encoding="ascii").split()[:2])
                seen[path.name] = ran, waited
                before = self._threads.get(path.name)
                if before == (ran, waited) and state_of(path) == "R":
                    most = passed
                elif before is not None:
                    most = max(most, (waited - before[1]) * 1e-9)
        self._threads = seen
        # What is added up late was counted by the state before.
        self.seconds += min(most, passed)
        return self.seconds


def state_of(path: Path) -> str:
    """Give the letter by which the kernel names the state of a process or thread, from its folder in /proc."""
    return (
        (path / "stat").read_text(encoding="ascii", errors="replace").rsplit(")", 1)[1].split()[0]
    )
