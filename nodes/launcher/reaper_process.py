"""The launcher's side of the reaper, which ends the nodes if the launcher is killed."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import IO, Final

from nodes.launcher import reaper
from nodes.launcher.child import PYTHON, Child

WAIT: Final = 2.0  # time that the reaper has to end before it is killed [s]


class ReaperProcess:
    """A reaper (nodes/launcher/reaper.py) that knows each process; replaced if it is gone."""

    def __init__(self, run_dir: Path, warn: Callable[[str], None]) -> None:
        self._run_dir, self._warn = run_dir, warn
        self._process = self._started()

    def _started(self) -> subprocess.Popen[bytes]:
        started = subprocess.Popen(
            [*PYTHON, "-S", "-E", str(reaper.__file__), str(self._run_dir)],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            start_new_session=True,
            bufsize=0,
        )
        assert started.stdin is not None  # noqa: S101
        os.set_blocking(started.stdin.fileno(), False)
        return started

    @property
    def _pipe(self) -> IO[bytes]:
        pipe = self._process.stdin
        assert pipe is not None  # noqa: S101
        return pipe

    def write_down(self, child: Child) -> None:
        """Report a process to the reaper, which notices by itself when it is gone."""
        if child.process is None:
            return
        line = b"%d %f\n" % (child.process.pid, child.opening + child.closing)
        # A reaper that is gone is replaced soon, and gets all processes; a stopped one must not
        # hold up the launcher.
        with contextlib.suppress(BrokenPipeError, BlockingIOError):
            os.write(self._pipe.fileno(), line)

    def check(self, children: Iterable[Child]) -> None:
        """Start another reaper if this one is gone."""
        if self._process.poll() is None:
            return
        self._warn(
            f"the reaper ended with exit code {self._process.returncode}; starting another"
        )
        self._pipe.close()
        self._process = self._started()
        for child in children:
            if child.running:
                self.write_down(child)

    def dismiss(self) -> None:
        """End the reaper: all nodes are gone."""
        # It may have been killed this moment; then nothing is left for it to do.
        with contextlib.suppress(BrokenPipeError):
            self._pipe.write(b"done\n")
        with contextlib.suppress(BrokenPipeError):
            self._pipe.close()
        # A stopped reaper must not hold up the launcher: its work is done.
        self._process.send_signal(signal.SIGCONT)
        try:
            self._process.wait(WAIT)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
