"""Independent jobs of a study, done in this process or by an executor: processes of this machine, or workers of a cluster.

Whatever they run on, the figures are the same to the bit: so a worker that has another version of
this project refuses its jobs, and one that dies loses none. A sweep keeps each result as a line of
a ledger, keyed by the job's parameters: one that was interrupted goes on where it stopped, and one
that is complete is only read; one of another version is refused.
"""

import contextlib
import functools
import hashlib
import json
import os
import platform
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import CancelledError, Executor, Future, as_completed
from pathlib import Path
from typing import Any, TypeVar

from messages.errors import RefusedError

J = TypeVar("J")
R = TypeVar("R")

RETRIES = 3  # how often a job is given to another worker when one dies
# Does the jobs of a part of a study, and tells each that is done.
Runner = Callable[[list[Callable[[], Any]], Callable[[str, int], None]], list[Any]]
_ROOT = Path(__file__).parents[2]


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
            f"the worker on {platform.node()} (process {os.getpid()}) has another version of"
            f" haptic-nodes in {_ROOT}: its figures would not be those of this one; install the"
            " same version there, and restart the worker"
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
        raise RefusedError(
            "--cluster: the scheduler is gone; what was done is kept where a study keeps it"
        ) from error
    except Exception as error:
        # By name: Dask is an extra.
        if type(error).__name__ == "KilledWorker":
            raise RefusedError(
                f"--cluster: {RETRIES + 1} workers died over one job; their own logs say of what,"
                " memory most often"
            ) from error
        raise


SweepRow = dict[str, Any]
# From the parameters of a job to its figures; a function of a module, so that other processes find
# it by name.
Job = Callable[[Mapping[str, Any]], SweepRow]


def key_of(parameters: Mapping[str, Any]) -> str:
    """Name a job by its parameters."""
    return json.dumps(dict(parameters), sort_keys=True)


def read_ledger(path: Path) -> dict[str, SweepRow]:
    """Read the results that there are; those of another version of this program are refused."""
    found: dict[str, SweepRow] = {}
    if path.exists():
        for line in path.read_text(encoding="utf-8").splitlines():
            try:
                entry = json.loads(line)
                found[key_of(entry["job"])] = entry["row"]
            except (json.JSONDecodeError, KeyError, TypeError):
                continue
            if entry.get("program") != program():
                raise RefusedError(
                    f"{path}: holds results of another version of haptic-nodes, which do not belong"
                    " in one study with those of this one; --fresh begins anew and sets them"
                    " aside, or go on with that version"
                )
    return found


def sweep(
    job: Job,
    jobs: Sequence[Mapping[str, Any]],
    pool: Executor,
    ledger: Path,
    chunk: int = 1,
    step: Callable[[str, int], None] = lambda *_: None,
) -> list[SweepRow]:
    """Do all jobs that the ledger has no result of."""
    done = read_ledger(ledger)
    left = [parameters for parameters in jobs if key_of(parameters) not in done]
    if len(left) < len(jobs):
        step(f"{len(jobs) - len(left)} of {len(jobs)} were done before", len(jobs) - len(left))
    ledger.parent.mkdir(parents=True, exist_ok=True)
    whole = not ledger.exists() or ledger.read_bytes().endswith(b"\n") or not ledger.stat().st_size
    with (
        open(ledger, "a", encoding="utf-8") as file,
        contextlib.closing(done_by(pool, job, left, chunk)) as found,
    ):
        if not whole:
            file.write("\n")
        for part, rows in found:
            for i, row in zip(part, rows, strict=True):
                file.write(
                    json.dumps({"job": dict(left[i]), "row": row, "program": program()}) + "\n"
                )
                done[key_of(left[i])] = row
            file.flush()
            step(f"{len(done)} of {len(jobs)}", len(rows))
    return [done[key_of(parameters)] for parameters in jobs]
