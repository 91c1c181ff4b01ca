"""The guard: what is left to do when the launcher itself is killed.

A small process of its own session. The launcher tells it each node's number over a pipe; when the pipe closes without a
``done``, the launcher is dead: the guard stops the nodes (SIGTERM, then SIGKILL, which also ends a stopped one) and removes
the run's directory. It imports nothing but the standard library, so that it is small and cannot fail with the rest.
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


def _is_ours(pid: int, run_dir: str) -> bool:
    try:
        if os.fsencode(run_dir) not in Path(f"/proc/{pid}/cmdline").read_bytes():
            return False
        state = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace")
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state.rsplit(")", 1)[1].split()[0] not in "ZX"


def end(pids: set[int], run_dir: str) -> None:
    """Stop the nodes of a run and remove its directory.

    Parameters
    ----------
    pids : set of int
        Process numbers that the launcher started.
    run_dir : str
        Directory of the run.
    """
    deadline = time.monotonic() + GRACE
    for number in (signal.SIGTERM, signal.SIGKILL):
        for pid in pids:
            if _is_ours(pid, run_dir):
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, number)
        while any(_is_ours(pid, run_dir) for pid in pids) and time.monotonic() < deadline:
            time.sleep(0.02)
        deadline = time.monotonic() + GRACE
    shutil.rmtree(run_dir, ignore_errors=True)


def main(arguments: list[str]) -> int:
    """Watch one launcher: ``python guard.py RUN_DIR`` with the pipe as standard input.

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
    pids: set[int] = set()
    for line in sys.stdin:
        word = line.strip()
        if word == "done":
            return 0
        if word.startswith("+"):
            pids.add(int(word[1:]))
        elif word.startswith("-"):
            pids.discard(int(word[1:]))
    end(pids, arguments[0])
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
