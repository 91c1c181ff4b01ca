"""Signals that end a program: deferred, ignored during a restore, or received once.

Only the main thread is interrupted; elsewhere each of these does nothing.
"""

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from types import FrameType
from typing import Any

# What ends a verb: Ctrl-C, a polite kill, and a terminal that is closed.
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@contextlib.contextmanager
def _handled(handler: Callable[..., Any] | signal.Handlers) -> Iterator[None]:
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, handler) for number in SIGNALS}
    try:
        yield
    finally:
        for number, former in before.items():
            signal.signal(number, former)


@contextlib.contextmanager
def deferred() -> Iterator[Sequence[object]]:
    """Run this block to its end; signals received meanwhile are handled after it.

    A request that was sent is answered before anything is put back, or it might come after; and a
    ``KeyboardInterrupt`` that is raised inside a finaliser, as sockets and Python's locks of
    imports have one, is printed and forgotten, and a notebook's cell would go on.
    """
    came: list[tuple[int, FrameType | None]] = []
    before: dict[signal.Signals, Callable[[int, FrameType | None], Any]] = {}
    if threading.current_thread() is threading.main_thread():
        for number in SIGNALS:
            former = signal.getsignal(number)
            # SIG_IGN and SIG_DFL run no Python.
            if callable(former):
                before[number] = former
                signal.signal(
                    number, lambda number, frame: came.append((number, frame))
                )
    try:
        yield came
    finally:
        for number, former in before.items():
            signal.signal(number, former)
        if came:
            number_came, frame = came[0]
            before[signal.Signals(number_came)](number_came, frame)


def undisturbed() -> contextlib.AbstractContextManager[None]:
    """Ignore signals while a launch is restored, so that a second one cannot cut it short."""
    return _handled(signal.SIG_IGN)


@contextlib.contextmanager
def interrupted_once() -> Iterator[Callable[[], int]]:
    """Yield a function that returns the first signal's number, or 0; ignore later ones."""
    first: list[int] = []

    def leave(number: int, _: object) -> None:
        if first:
            # It had come before the first was handled: what is being put back goes on.
            return
        for known in SIGNALS:
            signal.signal(known, signal.SIG_IGN)
        first.append(number)
        raise KeyboardInterrupt

    with _handled(leave):
        yield lambda: first[0] if first else 0
