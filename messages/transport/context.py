"""The context of a process: its I/O threads, of which the second one serves listeners, off the loop's processor."""

import contextlib
import os
import time
import traceback
from collections.abc import Collection
from pathlib import Path
from typing import Any

import zmq

from messages.transport.endpoints import Context

STARTING = 2.0  # how long a new thread may take to tell its name [s]
ASIDE = 10  # so much below a loop's priority are threads of its process that serve others


class _Socket(zmq.Socket[bytes]):
    def close(self, linger: int | None = None) -> None:
        try:
            super().close(linger)
        except BaseException:
            # The context may have forgotten it already.
            super().close(linger)
            raise


class _Context(zmq.Context[zmq.Socket[bytes]]):
    """A context that can be ended after a signal's exception has interrupted the making or closing of a socket."""

    _socket_class = _Socket

    def socket(self, *what: Any, **options: Any) -> Any:
        try:
            return super().socket(*what, **options)
        except BaseException as error:
            # What a signal's handler raises meanwhile leaves a socket that the context does not
            # know, in the frames of the traceback: nobody could close it, and the context's end
            # would wait for it for ever.
            traceback.clear_frames(error.__traceback__)
            raise


def new_context(aside: bool = False) -> Context:
    """Make a context whose sockets never delay its end; its I/O threads inherit affinity and priority of the calling thread."""
    context = _Context(io_threads=2 if aside else 1)
    context.linger = 0
    return context


def move_aside(processors: Collection[int]) -> None:
    """Take the second I/O thread, which serves listeners, to other processors and below the priority of the chain."""
    until = time.monotonic() + STARTING
    while not (thread := _second_thread()):
        if time.monotonic() > until:
            return
        # It names itself when it gets its turn, for which this one, on the same core and as urgent,
        # has to wait.
        time.sleep(0.001)
    if os.sched_getscheduler(thread) == os.SCHED_FIFO:
        # Above what else the machine does: a recording would lack what waits too long for it. Below
        # who answers requests.
        priority = max(1, os.sched_getparam(thread).sched_priority - ASIDE - 1)
        os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(priority))
    if processors:
        # Refused where the node was started among others.
        with contextlib.suppress(OSError):
            os.sched_setaffinity(thread, processors)


def _second_thread() -> int:
    """Find the second I/O thread by the name that libzmq gives it; 0 while there is none."""
    for path in Path("/proc/self/task").iterdir():
        # One that is listed may have ended.
        with contextlib.suppress(OSError):
            if (
                (path / "comm")
                .read_text(encoding="ascii", errors="replace")
                .strip()
                .endswith("IO/1")
            ):
                return int(path.name)
    return 0
