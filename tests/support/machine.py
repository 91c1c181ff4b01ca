"""Share one machine among all workers: several tests at a time, at most two ``realtime``."""

from __future__ import annotations

import contextlib
import fcntl
import itertools
import os
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import IO


def _either(halves: tuple[IO[str], ...]) -> None:
    """Lock whichever half is free first."""
    for half in itertools.cycle(halves):
        with contextlib.suppress(BlockingIOError):
            fcntl.flock(half, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return
        time.sleep(0.02)


@contextlib.contextmanager
def machine(run: str, alone: bool) -> Iterator[None]:
    """Share the machine with the other workers' tests, or reserve half of it."""
    # Who waits to be alone holds the queue, so that no test begins before it: without it, others
    # would never let it in.
    place = Path(tempfile.gettempdir()) / f"haptic-tests-{os.getuid()}-{run}"
    with (
        open(f"{place}.queue", "w") as queue,
        open(f"{place}.0", "w") as one,
        open(f"{place}.1", "w") as other,
    ):
        fcntl.flock(queue, fcntl.LOCK_EX)
        if alone:
            # A loop in real time sleeps for most of a tick: two of them share the machine, but not
            # with what computes.
            _either((one, other))
        else:
            fcntl.flock(one, fcntl.LOCK_SH)
            fcntl.flock(other, fcntl.LOCK_SH)
        fcntl.flock(queue, fcntl.LOCK_UN)
        yield
