"""A loop that stands still, noticed from another thread: a device's call that hangs is an end like any other, not a silence.

Who looks does so about twice a second. Time in which it was stopped or starved itself does not
count: it saw nothing then. Nor does time in which what it looks at was kept from running. The
launcher looks at its processes with the same `HangWatchdog`.
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

HUNG = 3  # exit code of a node that has given itself up
SENDING = 0.2  # how long its last messages may take to leave [s]
LOOK = 0.4  # shortest time between two looks [s]


# so much longer than its limit may a call hold the interpreter's lock, in which nobody can look [s]
GRACE = 5.0


class LastResort:
    """Ends the process when not even the thread that looks can run: the call that hangs holds the interpreter's lock.

    It is a timer of the interpreter's own, in C, which needs no lock. All that it can say is where
    the threads were, to a file that the launcher reads. A process that was stopped for so long ends
    too; its device has let go by then.
    """

    def __init__(self, setup: Setup) -> None:
        self._file = open(_last_place(setup), "wb")  # noqa: SIM115  # as long as the process
        self._limit = self._wound = 0.0

    def postpone(self, limit: float) -> None:
        """Put off the end, as long as somebody can."""
        if self._wound == math.inf:
            return
        now = time.monotonic()
        if limit != self._limit or now - self._wound >= LOOK:
            self._limit, self._wound = limit, now
            faulthandler.dump_traceback_later(limit + GRACE, exit=True, file=self._file)

    def stop(self) -> None:
        """Let the process end by itself."""
        self._limit = self._wound = math.inf
        faulthandler.cancel_dump_traceback_later()


def _last_place(setup: Setup) -> Path:
    return Path(setup.run_dir) / f"{setup.name}.hung"


def held_in(setup: Setup) -> str:
    """Tell for how long, and where, the loop's thread of a process that `LastResort` has ended was; empty for any other end."""
    path = _last_place(setup)
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines() if path.exists() else []
    # The main thread comes last, its innermost call first.
    heads = [number for number, line in enumerate(lines) if line.startswith("Thread ")]
    places = lines[heads[-1] + 1 :] if heads else lines[1:]
    if not places:
        return ""
    hours, minutes, seconds = lines[0].removeprefix("Timeout (").removesuffix(")!").split(":")
    return f"{3600 * int(hours) + 60 * int(minutes) + float(seconds):g} s: {places[0].strip()}"


class HangWatchdog:
    """How long nothing has changed."""

    def __init__(self) -> None:
        self._last: object = None
        self._looked = time.monotonic()
        self._stood = self._waited = 0.0

    def look(self, progress: object, waited: float = 0.0) -> float:
        """Look once more; `waited`: what it has waited for a processor so far, because others had it [s]."""
        now = time.monotonic()
        passed = now - self._looked
        if progress != self._last:
            # At once: what is done next has a limit of its own.
            self._last, self._stood, self._looked, self._waited = progress, 0.0, now, waited
        elif passed >= LOOK:
            self._stood += max(0.0, min(passed, 2.0 * LOOK) - (waited - self._waited))
            self._looked, self._waited = now, waited
        return self._stood


def where(thread: int) -> str:
    """Tell what a thread is doing."""
    frame = sys._current_frames().get(thread)
    if frame is None:
        return ""
    last = traceback.extract_stack(frame)[-1]
    return f"{last.name} ({os.path.basename(last.filename)}, line {last.lineno})"


def give_up(node: Node, reason: str) -> None:
    """End a process whose loop will not end it: say why, publish it, write the report, go."""
    node.stop_reason, node.state, node.stopping = reason, "failed", True
    node.events.emit("hung", f"{reason}; it was in {where(node.events.loop_thread)}")
    node.events.publish(topics.status(node.setup.name), node.status())
    node.flush_outbox()
    write_report(node)
    time.sleep(SENDING)
    drain_stderr()
    os._exit(HUNG)
