"""The reaper: what is left to do when the launcher itself is killed.

A small process of its own session, holding the other end of a pipe. When the pipe closes without a ``done``, the launcher is
dead: the reaper stops the nodes of the run (SIGTERM, then SIGKILL) and removes its directory. It finds them by their command
line, so that one that was just being started is not forgotten. It imports nothing but the standard library, so that it is
small and cannot fail with the rest. A launcher whose reaper was killed starts another.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import sys
import time
from pathlib import Path

GRACE = 2.0
"""How long nodes have to stop by themselves [s]."""


def nodes_of(run_dir: str) -> list[int]:
    """Find the live nodes of a run.

    Parameters
    ----------
    run_dir : str
        Directory of the run; each node's command line names a file in it.

    Returns
    -------
    list of int
        Their process numbers, zombies left out.
    """
    wanted = os.fsencode(run_dir) + b"/"
    found = []
    for entry in os.listdir("/proc"):
        if not entry.isdigit() or int(entry) == os.getpid():
            continue
        try:
            words = Path(f"/proc/{entry}/cmdline").read_bytes().split(b"\0")
            state = Path(f"/proc/{entry}/stat").read_text(encoding="ascii", errors="replace")
        except (FileNotFoundError, ProcessLookupError):
            continue
        ours = b"nodes" in words and any(word.startswith(wanted) for word in words)
        if ours and state.rsplit(")", 1)[1].split()[0] not in "ZX":
            found.append(int(entry))
    return found


def end(run_dir: str) -> None:
    """Stop the nodes of a run and remove its directory.

    Parameters
    ----------
    run_dir : str
        Directory of the run.
    """
    for number in (signal.SIGTERM, signal.SIGKILL):
        deadline = time.monotonic() + GRACE
        for pid in nodes_of(run_dir):
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, number)
                # A stopped node must wake up to bring its force to zero or to close its file.
                os.kill(pid, signal.SIGCONT)
        while nodes_of(run_dir) and time.monotonic() < deadline:
            time.sleep(0.02)
    shutil.rmtree(run_dir, ignore_errors=True)


def main(arguments: list[str]) -> int:
    """Watch one launcher: ``python reaper.py RUN_DIR`` with the pipe as standard input.

    Parameters
    ----------
    arguments : list of str
        The run's directory.

    Returns
    -------
    int
        0.
    """
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    for line in sys.stdin:
        if line.strip() == "done":
            return 0
    end(arguments[0])
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
