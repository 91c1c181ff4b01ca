"""Leaving in order: the first Ctrl-C, SIGTERM or SIGHUP lets a verb put back what it borrowed; no later one disturbs that."""

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator
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


class _UnderWay:
    depth, left = 0, False


_under_way = _UnderWay()


@contextlib.contextmanager
def whole() -> Iterator[None]:
    """Leave only after this block: a request that was sent is answered before anything is put back, or it might come after."""
    _under_way.depth += 1
    try:
        yield
    finally:
        _under_way.depth -= 1
        if not _under_way.depth and _under_way.left:
            _under_way.left = False
            raise KeyboardInterrupt


def undisturbed() -> contextlib.AbstractContextManager[None]:
    """Ignore signals while a launch is put back: an impatient second one must not leave it half-way."""
    return _handled(signal.SIG_IGN)


@contextlib.contextmanager
def interrupted_once() -> Iterator[Callable[[], int]]:
    """Take the first signal as the order to leave, those after it as nothing; yields a question for its number, 0 for none."""
    first: list[int] = []

    def leave(number: int, _: object) -> None:
        if first:
            # It had come before the first was handled: what is being put back goes on.
            return
        for known in SIGNALS:
            signal.signal(known, signal.SIG_IGN)
        first.append(number)
        if _under_way.depth:
            _under_way.left = True
            return
        raise KeyboardInterrupt

    with _handled(leave):
        yield lambda: first[0] if first else 0
