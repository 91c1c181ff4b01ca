"""A small file in a run's private directory, mapped by two nodes to share data."""

from __future__ import annotations

import mmap
import os
import time
from collections.abc import Callable
from pathlib import Path

from nodes.base.setup import Setup

# longest wait for a file that another node creates when it starts [s]
FILE_TIMEOUT = 10.0


def mapped(path: Path, size: int, make: bool) -> mmap.mmap:
    """Return a mapped file of `size` bytes; FileNotFoundError if it does not exist."""
    descriptor = os.open(path, os.O_RDWR | (os.O_CREAT if make else 0), 0o600)
    try:
        if make:
            os.truncate(descriptor, size)
        return mmap.mmap(descriptor, size)
    finally:
        os.close(descriptor)


def awaited(
    path: Path,
    size: int,
    maker: Setup,
    given_up: Callable[[], bool],
    patience: float = FILE_TIMEOUT,
) -> Path:
    """Wait until a node that may start later has created a file. Return its path.

    A node on another machine never creates it, and is not waited for.
    """
    deadline = time.monotonic() + patience
    while (
        maker.control.startswith("ipc:")
        and time.monotonic() < deadline
        and not given_up()
    ):
        if path.exists() and path.stat().st_size == size:
            break
        time.sleep(0.005)
    return path
