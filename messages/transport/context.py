"""ZeroMQ context of a process; its second I/O thread serves listeners on other processors."""

import contextlib
import os
import time
import traceback
from collections.abc import Collection
from pathlib import Path
from typing import Any

import zmq

from messages.transport.endpoints import Context

STARTING = 2.0  # longest wait for a new thread's name [s]
ASIDE = 10  # priority below the loop's for other threads of its process


class _Socket(zmq.Socket[bytes]):
    def close(self, linger: int | None = None) -> None:
        try:
            super().close(linger)
        except BaseException:
            # The context may have forgotten it already.
            super().close(linger)
            raise


class _Context(zmq.Context[zmq.Socket[bytes]]):
    """A context that can end after a signal interrupted the creation or closing of a socket."""

    _socket_class = _Socket

    def socket(self, *what: Any, **options: Any) -> Any:
        try:
            return super().socket(*what, **options)
        except BaseException as error:
            # An exception of a signal handler leaves a socket unknown to the context in the
            # traceback's frames. Nobody could close it, and the context's end would block for ever.
            traceback.clear_frames(error.__traceback__)
            raise


def new_context(aside: bool = False) -> Context:
    """Return a context whose sockets never delay its end.

    Its I/O threads inherit affinity and priority of the calling thread. `aside` adds a thread for
    listeners.
    """
    context = _Context(io_threads=2 if aside else 1)
    context.linger = 0
    return context


def move_aside(processors: Collection[int]) -> None:
    """Move the second I/O thread to other processors and below the chain's priority."""
    until = time.monotonic() + STARTING
    while not (thread := _second_thread()):
        if time.monotonic() > until:
            return
        # It names itself once it runs, for which this thread, on the same core, must sleep.
        time.sleep(0.001)
    if os.sched_getscheduler(thread) == os.SCHED_FIFO:
        # Above the rest of the machine, because a recording would lose messages that wait too long;
        # below the thread that answers requests.
        priority = max(1, os.sched_getparam(thread).sched_priority - ASIDE - 1)
        os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(priority))
    if processors:
        # refused if the node was started with restricted processors
        with contextlib.suppress(OSError):
            os.sched_setaffinity(thread, processors)


def _second_thread() -> int:
    """Return the second I/O thread, found by libzmq's name for it; 0 if there is none."""
    for path in Path("/proc/self/task").iterdir():
        # a listed thread may have ended
        with contextlib.suppress(OSError):
            if (
                (path / "comm")
                .read_text(encoding="ascii", errors="replace")
                .strip()
                .endswith("IO/1")
            ):
                return int(path.name)
    return 0
