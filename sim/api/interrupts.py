"""Interrupts of a running cell: never in the middle of a request, where libzmq's own clean-up would swallow them."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator
from types import FrameType


@contextlib.contextmanager
def whole() -> Iterator[None]:
    """Do this block to its end; an interrupt that comes meanwhile is one at its end.

    A ``KeyboardInterrupt`` that is raised inside a finaliser, as a socket or context has one, is printed and forgotten: the
    cell would go on.
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
