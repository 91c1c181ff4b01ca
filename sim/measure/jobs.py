"""Run the independent jobs of a study in this process, local processes or a cluster.

Results are identical to the bit wherever they run: a worker with another version of this project
refuses its jobs, and the job of a worker that dies is repeated. A sweep stores each result as a
line of a ledger, keyed by the job's parameters: an interrupted sweep continues, a complete one is
only read, and one of another version is refused.
"""

import contextlib
import functools
import hashlib
import json
import os
import platform
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Executor, Future, wait
from pathlib import Path
from typing import Any, TypeVar

from messages.errors import RefusedError
from sim.measure.cancelling import PERIOD, check

J = TypeVar("J")
R = TypeVar("R")

RETRIES = 3  # times that a job is given to another worker if one dies
# Runs the jobs of a part of a study, and reports each one done.
Runner = Callable[[list[Callable[[], Any]], Callable[[str, int], None]], list[Any]]
_ROOT = Path(__file__).parents[2]


def call(job: Callable[[], R]) -> R:
    """Run a job that is a `functools.partial` of a module's function."""
    return job()


@functools.cache
def program() -> str:
    """Return a digest of this project's sources, to keep versions apart in one study."""
    found = hashlib.sha256()
    for package in ("messages", "nodes", "sim"):
        for path in sorted((_ROOT / package).rglob("*.py")):
            found.update(
                path.relative_to(_ROOT).as_posix().encode() + b"\0" + path.read_bytes()
            )
    return found.hexdigest()[:16]


def run_chunk(job: Callable[[J], R], chunk: Sequence[J], wanted: str) -> list[R]:
    """Run some jobs in one process; refuse those of another version."""
    if program() != wanted:
        raise RefusedError(
            f"the worker on {platform.node()} (process {os.getpid()}) has another version of"
            f" haptic-nodes in {_ROOT}, so its results could differ; install the same version"
            " there, and restart the worker"
        )
    return [job(parameters) for parameters in chunk]


def done_by(
    pool: Executor, job: Callable[[J], R], jobs: Sequence[J], chunk: int = 1
) -> Generator[tuple[range, list[R]], None, None]:
    """Distribute jobs to a pool; yield index range and results of each chunk when done."""
    pending: dict[Future[list[R]], range] = {}
    for first in range(0, len(jobs), chunk):
        part = range(first, min(first + chunk, len(jobs)))
        pending[pool.submit(run_chunk, job, [jobs[i] for i in part], program())] = part
    try:
        waiting = set(pending)
        while waiting:
            done, waiting = wait(waiting, PERIOD, FIRST_COMPLETED)
            check()
            # Those that failed last: what is done beside them is kept.
            for future in sorted(done, key=_failed):
                yield pending[future], _result(future)
    finally:
        # Cancel jobs not yet started, also after Ctrl-C.
        for future in pending:
            future.cancel()


def _failed(future: Future[list[R]]) -> bool:
    return future.cancelled() or future.exception() is not None


def _result(future: Future[list[R]]) -> list[R]:
    try:
        return future.result()
    except CancelledError as error:
        raise RefusedError(
            "--cluster: the scheduler has ended; finished jobs are stored in the study's ledger"
        ) from error
    except Exception as error:
        # Compared by name, because Dask is an optional extra.
        if type(error).__name__ == "KilledWorker":
            raise RefusedError(
                f"--cluster: {RETRIES + 1} workers died running one job; see their logs for the"
                " reason, most often memory"
            ) from error
        raise


SweepRow = dict[str, Any]
# Maps a job's parameters to its figures; a module's function, so that other processes can import
# it.
Job = Callable[[Mapping[str, Any]], SweepRow]


def key_of(parameters: Mapping[str, Any]) -> str:
    """Return the ledger key of a job's parameters."""
    return json.dumps(dict(parameters), sort_keys=True)


def read_ledger(path: Path) -> dict[str, SweepRow]:
    """Read the existing results; refuse those of another version."""
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
                    f"{path}: has results of another version of haptic-nodes, which cannot be mixed"
                    " with new ones; --fresh sets them aside and starts again, or use that"
                    " version"
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
    """Run all jobs without a result in the ledger; return all results."""
    done = read_ledger(ledger)
    left = [parameters for parameters in jobs if key_of(parameters) not in done]
    if len(left) < len(jobs):
        step(
            f"{len(jobs) - len(left)} of {len(jobs)} already done",
            len(jobs) - len(left),
        )
    ledger.parent.mkdir(parents=True, exist_ok=True)
    whole = (
        not ledger.exists()
        or ledger.read_bytes().endswith(b"\n")
        or not ledger.stat().st_size
    )
    with (
        open(ledger, "a", encoding="utf-8") as file,
        contextlib.closing(done_by(pool, job, left, chunk)) as found,
    ):
        if not whole:
            file.write("\n")
        for part, rows in found:
            for i, row in zip(part, rows, strict=True):
                file.write(
                    json.dumps({"job": dict(left[i]), "row": row, "program": program()})
                    + "\n"
                )
                done[key_of(left[i])] = row
            file.flush()
            step(f"{len(done)} of {len(jobs)}", len(rows))
    return [done[key_of(parameters)] for parameters in jobs]
