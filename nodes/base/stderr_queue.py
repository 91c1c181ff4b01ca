"""A queue to standard error that never blocks.

A reader may pause (a pager, Ctrl-S, a stalled ssh) or go away, and then a write to standard error
blocks or fails. Neither may affect a loop that applies a force, nor the launcher that ends it. So
lines go into a bounded queue, and a thread writes them. A full queue drops and counts them; a
node's events are published on its topic anyway.
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

MAX_QUEUED = 1000  # pieces of text that may wait
MAX_TEXT = 10_000  # longest piece of text [characters]; the rest is cut
DRAIN_TIMEOUT = 0.5  # longest wait for a reader at the end [s]

STDERR = 2


class StderrQueue(io.TextIOBase):
    """A text stream, as ``sys.stderr``, that never blocks or fails.

    `aside` moves its thread off a loop's processor.
    """

    def __init__(
        self, descriptor: int = STDERR, aside: Callable[[], None] = lambda: None
    ) -> None:
        self._descriptor = descriptor
        self._aside = aside
        # its put takes no lock that a signal handler or another thread could hold
        self._queue: SimpleQueue[str] = SimpleQueue()
        self._taken = self._put = 0
        self._gone = False
        # pieces of text dropped, because the queue was full or nobody reads
        self.dropped = 0
        self._thread = threading.Thread(target=self._run, name="words", daemon=True)
        self._thread.start()

    def write(self, text: str) -> int:
        """Queue some text."""
        if self._gone or self._queue.qsize() >= MAX_QUEUED:
            self.dropped += 1
        elif text:
            self._put += 1
            # A cut line still ends, so that the next one does not follow it in its line.
            end = "\n" if len(text) > MAX_TEXT and text.endswith("\n") else ""
            self._queue.put(text[:MAX_TEXT] + end)
        return len(text)

    def writable(self) -> bool:
        """Return True: the stream can be written to."""
        return True

    def isatty(self) -> bool:
        """Return whether the stream is a terminal."""
        return os.isatty(self._descriptor)

    def fileno(self) -> int:
        """Return the descriptor, for starting a process with it."""
        return self._descriptor

    @property
    def encoding(self) -> str:  # type: ignore[override]
        """Encoding of the stream."""
        return "utf-8"

    def drain(self, patience: float = DRAIN_TIMEOUT) -> None:
        """Wait until everything is written, at most `patience` [s]."""
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
                # another owner of the descriptor has made it non-blocking
                select.select((), (self._descriptor,), (), 1.0)
            except OSError as error:
                # A broken pipe or closed terminal stays so; a full disk may have room later.
                self._gone = error.errno in (errno.EPIPE, errno.EBADF, errno.EIO)
                self.dropped += 1
                return


def instead_of_stderr(
    aside: Callable[[], None] = lambda: None, stdout_too: bool = False
) -> StderrQueue:
    """Replace standard error by a queue, also for tracebacks and warnings."""
    words = StderrQueue(aside=aside)
    sys.stderr = words
    # a traceback comes after everything else at the end
    atexit.register(words.drain)
    if stdout_too:
        sys.stdout = words
    return words


def drain_stderr(patience: float = DRAIN_TIMEOUT) -> None:
    """Wait for the queued output at the end of a process, at most `patience` [s]."""
    if isinstance(sys.stderr, StderrQueue):
        sys.stderr.drain(patience)
