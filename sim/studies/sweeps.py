"""Run the jobs of a study here, in local processes or on a Dask cluster (``--cluster``)."""

import contextlib
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import urlsplit

from messages.errors import RefusedError, UsageError
from nodes.parameters.options import FileOptions, Options, ProgressStep, option
from nodes.parameters.quantities import whole
from sim.measure.cancelling import StudyCancelledError, check
from sim.measure.jobs import RETRIES, Job, SweepRow, call, done_by, sweep
from sim.results import fresh

# options with the certificates of a remote cluster
TLS = ("tls_ca_file", "tls_cert", "tls_key")
SPREAD = ("workers", "cluster", *TLS)  # options of where jobs run
R = TypeVar("R")


@dataclass(frozen=True, kw_only=True)
class SpreadOptions(Options):
    """Where the jobs of a study run."""

    workers: int = option(
        default=0,
        type=whole(0, 10_000),
        help="processes on this machine (default: none: one job after another, here)",
    )
    cluster: str | None = option(
        metavar="ADDRESS",
        help="Dask scheduler instead, tcp://127.0.0.1:8786 or tls://HOST:8786",
    )
    tls_ca_file: Path | None = option(
        type=Path, help="of a scheduler on another machine"
    )
    tls_cert: Path | None = option(type=Path, help="of a scheduler on another machine")
    tls_key: Path | None = option(type=Path, help="of a scheduler on another machine")


@dataclass(frozen=True, kw_only=True)
class SweepOptions(SpreadOptions, FileOptions):
    """Where a sweep runs, and whether it continues its ledger."""

    fresh: bool = option(
        action="store_true",
        help="start again instead of going on where it stopped; what there is is set aside",
    )
    workers: int = option(
        default=0,
        type=whole(0, 10_000),
        help="processes on this machine (default: one per core)",
    )


@contextlib.contextmanager
def executor(options: SpreadOptions) -> Iterator[Executor]:
    """Open the executor of the jobs."""
    if options.cluster is None:
        from nodes.base.workers import Workers

        with Workers(options.workers or os.cpu_count() or 1) as pool:
            yield pool
        return
    security = check_cluster(options)
    if not security:
        _say(
            f"{options.cluster}: any user of this machine may hold that port, get the jobs and"
            f" answer them; on a machine with several users, use tls:// with {_flags(TLS)}"
        )
    try:
        import distributed
    except ImportError as error:
        raise UsageError(
            "--cluster needs Dask: pip install 'haptic-nodes[cluster]'"
        ) from error
    dask: Any = distributed
    try:
        client = dask.Client(
            options.cluster,
            security=dask.Security(**security) if security else None,
            timeout="5s",
        )
    except (OSError, TimeoutError) as error:
        raise RefusedError(
            f"--cluster {options.cluster}: no scheduler answers ({error})"
        ) from error
    try:
        if not client.scheduler_info()["workers"]:
            _say(f"{options.cluster}: no worker there yet; the jobs wait for the first")
        yield client.get_executor(retries=RETRIES, pure=False)
    finally:
        client.close()


def _say(what: str) -> None:
    print(f"[sweep] {what}", file=sys.stderr, flush=True)


def _flags(names: Sequence[str]) -> str:
    return ", ".join(f"--{name.replace('_', '-')}" for name in names)


def check_cluster(options: SpreadOptions) -> dict[str, Any]:
    """Check a cluster's address; raise UsageError for a remote one without TLS.

    Its workers execute whatever they receive.
    """
    # Imported only for a cluster, because it loads network code.
    from messages.transport.endpoints import is_remote

    address = urlsplit(options.cluster)
    if address.scheme not in ("tcp", "tls") or not address.hostname or not address.port:
        raise UsageError(
            f"--cluster {options.cluster}: expected tcp://127.0.0.1:PORT or tls://HOST:PORT"
        )
    given = {name: getattr(options, name) for name in TLS}
    if address.scheme == "tcp":
        if is_remote(f"tcp://{address.hostname}:{address.port}"):
            raise UsageError(
                f"--cluster {options.cluster}: workers run what they are sent, so off this"
                f" machine TLS is required: tls://{address.hostname}:{address.port} with"
                f" {_flags(TLS)}"
            )
        return {}
    missing = [
        name for name, path in given.items() if path is None or not path.is_file()
    ]
    if missing:
        raise UsageError(
            f"--cluster {options.cluster}: needs the files {_flags(missing)}"
        )
    return {
        "require_encryption": True,
        "tls_ca_file": str(given["tls_ca_file"]),
        "tls_client_cert": str(given["tls_cert"]),
        "tls_client_key": str(given["tls_key"]),
    }


def swept(
    options: SweepOptions,
    job: Job,
    jobs: Sequence[Mapping[str, Any]],
    name: str,
    chunk: int = 1,
) -> tuple[list[SweepRow], Path]:
    """Run the jobs of a study with a ledger; return its rows in order, and its path.

    Jobs already in the ledger are not repeated. Progress is shown on stderr.
    """
    ledger = begun(options, name)
    try:
        with executor(options) as pool:
            return sweep(
                job, jobs, pool, ledger, chunk, options.progress(len(jobs))
            ), ledger
    except (KeyboardInterrupt, StudyCancelledError) as error:
        done = f"what is done is in {ledger}, and the same command goes on there"
        raise type(error)(done) from None


def begun(options: SweepOptions, name: str) -> Path:
    """Return the path of a study's ledger; with --fresh the existing one is set aside."""
    ledger = options.out / f"{name}.jsonl"
    return fresh(ledger) if options.fresh else ledger


def spread(
    options: SpreadOptions,
    jobs: Sequence[Callable[[], R]],
    chunk: int = 1,
    step: ProgressStep | None = None,
) -> list[R]:
    """Run all jobs where the options say; return their results in order, without a ledger.

    Each job is a `functools.partial` of a module's function, so that other processes find it by
    name. Progress is shown on stderr.
    """
    step = step or options.progress(len(jobs))
    results: dict[int, R] = {}

    def note(part: range, rows: list[R]) -> None:
        results.update(zip(part, rows, strict=True))
        step(f"{len(results)} of {len(jobs)}", len(rows))
        check()

    if options.cluster is None and not options.workers:
        for i, job in enumerate(jobs):
            note(range(i, i + 1), [job()])
    else:
        with (
            executor(options) as pool,
            contextlib.closing(done_by(pool, call, jobs, chunk)) as done,
        ):
            for part, rows in done:
                note(part, rows)
    return [results[i] for i in range(len(jobs))]
