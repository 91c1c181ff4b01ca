"""One machine for all workers of a run: several tests at a time, but one marked ``realtime`` has the machine to itself."""

from __future__ import annotations

import contextlib
import fcntl
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path


@contextlib.contextmanager
def machine(run: str, alone: bool) -> Iterator[None]:
    """Share the machine with the tests of the other workers of a run, or have it alone."""
    # Who waits to be alone holds the queue, so that no test begins before it: without it, others would never let it in.
    place = Path(tempfile.gettempdir()) / f"haptic-tests-{os.getuid()}-{run}"
    with open(f"{place}.queue", "w") as queue, open(f"{place}.machine", "w") as shared:
        fcntl.flock(queue, fcntl.LOCK_EX)
        fcntl.flock(shared, fcntl.LOCK_EX if alone else fcntl.LOCK_SH)
        fcntl.flock(queue, fcntl.LOCK_UN)
        yield
