"""The reaper: what is left to do when the launcher itself is killed.

A small process of its own session, holding the other end of a pipe. The launcher writes down each
node that it starts; when the pipe closes without a ``done``, the launcher is dead: the reaper stops
the nodes (SIGTERM, then SIGKILL) and removes the run's directory. It holds them by descriptors, so
that it needs no look into ``/proc``, which may be hidden, and no process number is mistaken for
another. A node that was just being started notices by itself that its parent is gone. The reaper
imports nothing but the standard library, so that it is small and cannot fail with the rest. A
launcher whose reaper was killed starts another.
"""

import contextlib
import os
import select
import shutil
import signal
import sys
import time

GRACE = 2.0  # how long a node has to stop by itself, beside what it was granted [s]


class Held:
    """One process, held so that its number cannot become another's; it may take so long to end, beside `GRACE` [s]."""

    def __init__(self, pid: int, seconds: float) -> None:
        self.seconds = seconds
        self._descriptor = os.pidfd_open(pid)

    @property
    def lives(self) -> bool:
        """Whether it has not ended yet."""
        return not select.select((self._descriptor,), (), (), 0.0)[0]

    def send(self, number: signal.Signals) -> None:
        """Send a signal; one that is gone does not mind."""
        with contextlib.suppress(ProcessLookupError):
            signal.pidfd_send_signal(self._descriptor, number)

    def close(self) -> None:
        """Let go of it."""
        os.close(self._descriptor)


def end(nodes: list[Held]) -> None:
    """Stop the nodes of a run."""
    for number in (signal.SIGTERM, signal.SIGKILL):
        patience = GRACE + max((node.seconds for node in nodes if node.lives), default=0.0)
        deadline = time.monotonic() + patience
        for node in nodes:
            node.send(number)
            # A stopped node must wake up to bring its force to zero or to close its file.
            node.send(signal.SIGCONT)
        while any(node.lives for node in nodes) and time.monotonic() < deadline:
            time.sleep(0.02)


def main(arguments: list[str]) -> int:
    """Watch one launcher: ``python reaper.py RUN_DIR`` with the pipe as standard input."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    nodes: dict[int, Held] = {}
    for line in sys.stdin:
        words = line.split()
        if words == ["done"]:
            return 0
        # The number of a node, and how long its end may take; the number may be one that another
        # has had before.
        if len(words) == 2 and words[0].isdigit():
            pid = int(words[0])
            if pid in nodes:
                nodes.pop(pid).close()
            with contextlib.suppress(ProcessLookupError):
                nodes[pid] = Held(pid, float(words[1]))
    end(list(nodes.values()))
    shutil.rmtree(arguments[0], ignore_errors=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
