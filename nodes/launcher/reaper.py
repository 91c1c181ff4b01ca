"""The reaper: cleans up if the launcher itself is killed.

A small process in its own session at the other end of a pipe. The launcher writes each node that it
starts; if the pipe closes without a ``done``, the launcher is dead, and the reaper stops the nodes
(SIGTERM, then SIGKILL) and removes the run's directory. It uses process descriptors, so it does not
need ``/proc``, which may be hidden, and cannot mistake a reused process number. A node that was
just being started notices by itself that its parent is gone. The reaper imports only the standard
library, to stay small and independent. A launcher starts a new reaper if it was killed.
"""

import contextlib
import os
import select
import shutil
import signal
import sys
import time

GRACE = 2.0  # time that a node has to stop by itself, beside its own allowance [s]


class Held:
    """A process held by descriptor, so that its number cannot be mistaken after reuse.

    `seconds` extends `GRACE`.
    """

    def __init__(self, pid: int, seconds: float) -> None:
        self.seconds = seconds
        self._descriptor = os.pidfd_open(pid)

    @property
    def lives(self) -> bool:
        """Whether it has not ended yet."""
        return not select.select((self._descriptor,), (), (), 0.0)[0]

    def send(self, number: signal.Signals) -> None:
        """Send a signal; ignore an ended process."""
        with contextlib.suppress(ProcessLookupError):
            signal.pidfd_send_signal(self._descriptor, number)

    def close(self) -> None:
        """Close the descriptor."""
        os.close(self._descriptor)


def end(nodes: list[Held]) -> None:
    """Stop the nodes of a run."""
    for number in (signal.SIGTERM, signal.SIGKILL):
        grace = GRACE + max((node.seconds for node in nodes if node.lives), default=0.0)
        deadline = time.monotonic() + grace
        for node in nodes:
            node.send(number)
            # A stopped node must wake to ramp its force to zero or close its file.
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
        # Process number of a node, possibly reused, and its allowance for the end [s].
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
