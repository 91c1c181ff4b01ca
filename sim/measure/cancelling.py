"""Cancel a study from another thread, or from its own progress callback.

The caller sets an event; the study looks at it between its parts and inside long searches, and ends
with `StudyCancelledError`. Worker processes are ended, and results that a ledger keeps remain.
"""

import contextlib
import threading
from collections.abc import Iterator
from contextvars import ContextVar

from messages.errors import HapticError
from nodes.parameters.options import ProgressOf, ProgressStep

PERIOD = 0.1  # longest time between two looks while other processes work [s]
_event: ContextVar[threading.Event | None] = ContextVar("cancelling", default=None)


class StudyCancelledError(HapticError):
    """A study ended early because its caller cancelled it."""


@contextlib.contextmanager
def cancelled_by(event: threading.Event | None) -> Iterator[None]:
    """End what runs in this block once the event is set; None: never."""
    token = _event.set(event)
    try:
        yield
    finally:
        _event.reset(token)


def check() -> None:
    """Raise `StudyCancelledError` if the study that runs here was cancelled."""
    event = _event.get()
    if event is not None and event.is_set():
        raise StudyCancelledError("cancelled by its caller")


def stopping(progress: ProgressOf) -> ProgressOf:
    """Return a progress display whose steps end a cancelled study."""

    def begin(total: int) -> ProgressStep:
        check()
        step = progress(total)

        def stepped(what: str, count: int = 1) -> None:
            step(what, count)
            check()

        return stepped

    return begin
