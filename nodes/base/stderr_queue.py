"""A queue to standard error that nobody waits for.

A reader may pause (a pager, Ctrl-S, a stalled ssh) or go away, and then a write to standard error
blocks or fails. Neither may reach a loop that holds a force, nor the launcher that ends it. So
lines go into a bounded queue, and a thread of its own writes them. What finds the queue full is
dropped and counted; the events of a node are on its topic all the same.
"""

import atexit
import contextlib
import errno
import io
import os
import select
import sys
import threading
import time
from collections.abc import Callable
from queue import SimpleQueue

LIMIT = 1000  # pieces of text that wait at most
LONGEST = 10_000  # longest piece of text [characters]; what is longer is cut
PATIENCE = 0.5  # how long an end waits for a reader [s]

STDERR = 2


class StderrQueue(io.TextIOBase):
    """A text stream, as ``sys.stderr``, that never blocks nor fails; `aside` takes its thread out of the way of a loop."""

    def __init__(self, descriptor: int = STDERR, aside: Callable[[], None] = lambda: None) -> None:
        self._descriptor = descriptor
        self._aside = aside
        # Its put takes no lock that a signal handler or another thread could hold.
        self._queue: SimpleQueue[str] = SimpleQueue()
        self._taken = self._put = 0
        self._gone = False
        self.dropped = 0  # pieces of text that found the queue full, or nobody to read them
        self._thread = threading.Thread(target=self._run, name="words", daemon=True)
        self._thread.start()

    def write(self, text: str) -> int:
        """Queue some text."""
        if self._gone or self._queue.qsize() >= LIMIT:
            self.dropped += 1
        elif text:
            self._put += 1
            self._queue.put(text[:LONGEST])
        return len(text)

    def writable(self) -> bool:
        """Tell that it can be written to."""
        return True

    def isatty(self) -> bool:
        """Tell whether a terminal shows it."""
        return os.isatty(self._descriptor)

    def fileno(self) -> int:
        """Tell where the text goes, for who starts a process with it."""
        return self._descriptor

    @property
    def encoding(self) -> str:  # type: ignore[override]
        """Its encoding."""
        return "utf-8"

    def drain(self, patience: float = PATIENCE) -> None:
        """Wait until all is written, at an end: not for longer than a reader may be given."""
        until = time.monotonic() + patience
        while self._taken < self._put and not self._gone and time.monotonic() < until:
            time.sleep(0.002)

    def _run(self) -> None:
        with contextlib.suppress(OSError):
            self._aside()
        reported = 0
        while True:
            text = self._queue.get()
            if self.dropped > reported and not self._gone:
                text = (
                    f"({self.dropped - reported} lines were dropped: nobody read them in"
                    f" time)\n{text}"
                )
                reported = self.dropped
            self._write_out(text.encode(errors="replace"))
            self._taken += 1

    def _write_out(self, data: bytes) -> None:
        view = memoryview(data)
        while view and not self._gone:
            try:
                view = view[os.write(self._descriptor, view) :]
            except BlockingIOError:
                # Somebody who shares the descriptor has made it non-blocking.
                select.select((), (self._descriptor,), (), 1.0)
            except OSError as error:
                # A broken pipe or a terminal that is gone stays so; a full disk may have room
                # later.
                self._gone = error.errno in (errno.EPIPE, errno.EBADF, errno.EIO)
                self.dropped += 1
                return


def instead_of_stderr(
    aside: Callable[[], None] = lambda: None, stdout_too: bool = False
) -> StderrQueue:
    """Let everything that this process prints to standard error go through a queue, tracebacks and warnings included."""
    words = StderrQueue(aside=aside)
    sys.stderr = words
    # A traceback comes after everything else that an end could wait for.
    atexit.register(words.drain)
    if stdout_too:
        sys.stdout = words
    return words


def drain_stderr(patience: float = PATIENCE) -> None:
    """Wait for what was printed, at the end of a process, but not for a reader that does not read."""
    if isinstance(sys.stderr, StderrQueue):
        sys.stderr.drain(patience)
