"""Detecting a hanging loop from another thread, so that a hanging device ends the run.

The check runs about twice a second. Time in which the checking thread itself was stopped or starved
does not count, nor time in which the checked process was starved. The launcher checks its processes
with the same `HangWatchdog`.
"""

import faulthandler
import math
import os
import sys
import time
import traceback
from pathlib import Path

from messages import topics
from nodes.base.node import Node
from nodes.base.setup import Setup
from nodes.base.status_report import write_report
from nodes.base.stderr_queue import drain_stderr

HUNG = 3  # exit code of a node that has ended itself
SENDING = 0.2  # time for its last messages to leave [s]
CHECK_INTERVAL = 0.4  # shortest interval of checks [s]


# extra time that a call may hold the GIL before the process is killed [s]
GRACE = 5.0


class LastResort:
    """Ends the process if a hanging call holds the GIL, so that no other thread can check.

    It is a C timer of the interpreter that needs no lock. It can only write the threads' positions
    to a file, which the launcher reads. A process that was stopped for as long ends too; its device
    has let go by then.
    """

    def __init__(self, setup: Setup) -> None:
        self._file = open(_last_place(setup), "wb")  # noqa: SIM115  # open as long as the process
        self._limit = self._wound = 0.0

    def postpone(self, limit: float) -> None:
        """Postpone the end, while a thread can still run."""
        if self._wound == math.inf:
            return
        now = time.monotonic()
        if limit != self._limit or now - self._wound >= CHECK_INTERVAL:
            self._limit, self._wound = limit, now
            faulthandler.dump_traceback_later(limit + GRACE, exit=True, file=self._file)

    def stop(self) -> None:
        """Cancel it."""
        self._limit = self._wound = math.inf
        faulthandler.cancel_dump_traceback_later()


def _last_place(setup: Setup) -> Path:
    return Path(setup.run_dir) / f"{setup.name}.hung"


def held_in(setup: Setup) -> str:
    """Return how long and where a process hung that `LastResort` ended, or ""."""
    path = _last_place(setup)
    lines = (
        path.read_text(encoding="utf-8", errors="replace").splitlines()
        if path.exists()
        else []
    )
    # The main thread comes last, its innermost call first.
    heads = [number for number, line in enumerate(lines) if line.startswith("Thread ")]
    places = lines[heads[-1] + 1 :] if heads else lines[1:]
    if not places:
        return ""
    hours, minutes, seconds = (
        lines[0].removeprefix("Timeout (").removesuffix(")!").split(":")
    )
    return f"{3600 * int(hours) + 60 * int(minutes) + float(seconds):g} s: {places[0].strip()}"


class HangWatchdog:
    """Time without progress."""

    def __init__(self) -> None:
        self._last: object = None
        self._checked = time.monotonic()
        self._stood = self._waited = 0.0

    def check(self, progress: object, waited: float = 0.0) -> float:
        """Check the progress. Return the time without any [s].

        `waited` is the total time for which the process waited for a processor [s].
        """
        now = time.monotonic()
        passed = now - self._checked
        if progress != self._last:
            # the next activity has a limit of its own
            self._last = progress
            self._stood = 0.0
            self._checked = now
            self._waited = waited
        elif passed >= CHECK_INTERVAL:
            self._stood += max(
                0.0, min(passed, 2.0 * CHECK_INTERVAL) - (waited - self._waited)
            )
            self._checked, self._waited = now, waited
        return self._stood


def where(thread: int) -> str:
    """Return what a thread is doing."""
    frame = sys._current_frames().get(thread)
    if frame is None:
        return ""
    last = traceback.extract_stack(frame)[-1]
    return f"{last.name} ({os.path.basename(last.filename)}, line {last.lineno})"


def give_up(node: Node, reason: str) -> None:
    """End a process whose loop hangs: report the reason, publish, write the report, exit."""
    node.stop_reason = reason
    node.state = "failed"
    node.stopping = True
    node.events.emit("hung", f"{reason}; it was in {where(node.events.loop_thread)}")
    node.events.publish(topics.status(node.setup.name), node.status())
    node.flush_outbox()
    write_report(node)
    time.sleep(SENDING)
    drain_stderr()
    os._exit(HUNG)
