"""Commands beside a notebook, ended and interrupted in order."""

import contextlib
import os
import signal
import subprocess
import threading
from collections.abc import Iterator
from types import FrameType
from typing import Any

ENDS_WITHIN = 60.0  # how long a launch may take to end [s]


def end(process: subprocess.Popen[Any]) -> None:
    """End a command beside this process as Ctrl-C does; what does not end is killed, and all that it has started."""
    process.send_signal(signal.SIGINT)
    try:
        process.wait(ENDS_WITHIN)
    except BaseException as error:
        # A cell that was interrupted leaves nothing behind, even one that is interrupted twice.
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        if not isinstance(error, subprocess.TimeoutExpired):
            raise


@contextlib.contextmanager
def whole() -> Iterator[None]:
    """Do this block to its end; an interrupt that comes meanwhile is one at its end.

    In the middle of a request libzmq's own clean-up would swallow it: a ``KeyboardInterrupt`` that is raised inside a
    finaliser, as a socket or context has one, is printed and forgotten, and the cell would go on.
    """
    before = signal.getsignal(signal.SIGINT)
    # Only the main thread is interrupted; SIG_IGN and SIG_DFL run no Python.
    if threading.current_thread() is not threading.main_thread() or not callable(before):
        yield
        return
    came: list[tuple[int, FrameType | None]] = []
    signal.signal(signal.SIGINT, lambda number, frame: came.append((number, frame)))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        if came:
            before(*came[0])
