"""The context of a process: its I/O threads, of which the second one serves listeners, off the loop's processor."""

import os
from pathlib import Path

import zmq

from messages.transport.endpoints import Context


def new_context(aside: bool = False) -> Context:
    """Make a context whose sockets never delay its end; its I/O threads inherit affinity and priority of the calling thread."""
    context: Context = zmq.Context(io_threads=2 if aside else 1)
    context.linger = 0
    return context


def move_aside() -> None:
    """Take the second I/O thread, which serves listeners, off the chain's core and its priority, when a first socket exists."""
    for path in Path("/proc/self/task").iterdir():
        # libzmq names its threads by their number.
        if (path / "comm").read_text(encoding="ascii", errors="replace").strip().endswith("IO/1"):
            thread = int(path.name)
            others = set(range(os.cpu_count() or 1)) - os.sched_getaffinity(0)
            os.sched_setscheduler(thread, os.SCHED_OTHER, os.sched_param(0))
            if others:
                os.sched_setaffinity(thread, others)
