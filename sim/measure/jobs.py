"""Independent jobs of a study, done in this process or by an executor: processes of this machine, or workers of a cluster.

Whatever they run on, the figures are the same to the bit: so a worker that has another version of this project refuses its
jobs, and one that dies loses none.
"""

from __future__ import annotations

import functools
import hashlib
import os
import platform
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import CancelledError, Executor, Future, as_completed
from pathlib import Path
from typing import Any, TypeVar

from messages.errors import RefusedError

J = TypeVar("J")
R = TypeVar("R")

RETRIES = 3
"""How often a job is given to another worker when one dies."""

Spread = Callable[[list[Callable[[], Any]], Callable[[str, int], None]], list[Any]]
"""Does the jobs of a part of a study, and tells each that is done."""

_ROOT = Path(__file__).parents[2]


def here(jobs: list[Callable[[], Any]], step: Callable[[str, int], None]) -> list[Any]:
    """Do jobs one after another in this process."""
    done = []
    for number, job in enumerate(jobs, 1):
        done.append(job())
        step(f"{number} of {len(jobs)}", 1)
    return done


def call(job: Callable[[], R]) -> R:
    """Do a job that is a `functools.partial` of a module's function."""
    return job()


@functools.cache
def program() -> str:
    """Tell what program this is: a digest of its sources; figures of two programs do not belong in one study."""
    found = hashlib.sha256()
    for package in ("messages", "nodes", "sim"):
        for path in sorted((_ROOT / package).rglob("*.py")):
            found.update(path.relative_to(_ROOT).as_posix().encode() + b"\0" + path.read_bytes())
    return found.hexdigest()[:16]


def run_chunk(job: Callable[[J], R], chunk: Sequence[J], wanted: str) -> list[R]:
    """Do some jobs one after another, in one process; refuse those of another program."""
    if program() != wanted:
        raise RefusedError(
            f"the worker on {platform.node()} (process {os.getpid()}) has another version of haptic-nodes in {_ROOT}: "
            "its figures would not be those of this one; install the same version there, and restart the worker"
        )
    return [job(parameters) for parameters in chunk]


def done_by(
    pool: Executor, job: Callable[[J], R], jobs: Sequence[J], chunk: int = 1
) -> Generator[tuple[range, list[R]], None, None]:
    """Give the jobs out, and yield what is done as it comes: which jobs, and their results."""
    pending: dict[Future[list[R]], range] = {}
    for first in range(0, len(jobs), chunk):
        part = range(first, min(first + chunk, len(jobs)))
        pending[pool.submit(run_chunk, job, [jobs[i] for i in part], program())] = part
    try:
        for future in as_completed(pending):
            yield pending[future], _result(future)
    finally:
        # Ctrl-C too: what has not begun need not begin.
        for future in pending:
            future.cancel()


def _result(future: Future[list[R]]) -> list[R]:
    try:
        return future.result()
    except CancelledError as error:
        raise RefusedError("--cluster: the scheduler is gone; what was done is kept where a study keeps it") from error
    except Exception as error:
        # By name: Dask is an extra.
        if type(error).__name__ == "KilledWorker":
            raise RefusedError(
                f"--cluster: {RETRIES + 1} workers died over one job; their own logs say of what, memory most often"
            ) from error
        raise
