"""One machine for all workers of a run: several tests at a time, but of those marked ``realtime`` only one, or two of them."""

from __future__ import annotations

import contextlib
import fcntl
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path


@contextlib.contextmanager
def machine(run: str, worker: str, alone: bool) -> Iterator[None]:
    """Share the machine with the tests of the other workers of a run, or have half of it alone."""
    # Who waits to be alone holds the queue, so that no test begins before it: without it, others would never let it in.
    place = Path(tempfile.gettempdir()) / f"haptic-tests-{os.getuid()}-{run}"
    with open(f"{place}.queue", "w") as queue, open(f"{place}.0", "w") as one, open(f"{place}.1", "w") as other:
        fcntl.flock(queue, fcntl.LOCK_EX)
        if alone:
            # A loop in real time sleeps for most of a tick: two of them share the machine, but not with what computes.
            fcntl.flock((one, other)[int(worker.removeprefix("gw")) % 2], fcntl.LOCK_EX)
        else:
            fcntl.flock(one, fcntl.LOCK_SH)
            fcntl.flock(other, fcntl.LOCK_SH)
        fcntl.flock(queue, fcntl.LOCK_UN)
        yield
