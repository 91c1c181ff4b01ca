"""Where the jobs of a study run: here, in processes of this machine, or on the workers of a Dask scheduler (``--cluster``)."""

import argparse
import contextlib
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import urlsplit

from messages.errors import RefusedError, UsageError
from messages.transport.endpoints import is_remote
from nodes.base.workers import Workers
from nodes.cli.quantities import whole
from sim.measure.jobs import RETRIES, Job, SweepRow, call, done_by, sweep
from sim.measure.stopwatch import Progress
from sim.results import fresh

# options that hold the certificates of a cluster off this machine
TLS = ("tls-ca-file", "tls-cert", "tls-key")
SPREAD = ("workers", "cluster", *TLS)  # options of where jobs run
PATIENCE = 2.0  # what is done so soon shows no progress [s]
R = TypeVar("R")


def add_sweep(parser: argparse.ArgumentParser) -> None:
    """Declare where a sweep runs, and whether it goes on."""
    parser.add_argument(
        "--fresh",
        action="store_true",
        help="start again instead of going on where it stopped; what there is is set aside",
    )
    add_spread(parser, "one per core")


def add_spread(
    parser: argparse.ArgumentParser, alone: str = "none: one job after another, here"
) -> None:
    """Declare where the jobs of a study run."""
    parser.add_argument(
        "--workers",
        type=whole(0, 10_000),
        default=0,
        help=f"processes on this machine (default: {alone})",
    )
    parser.add_argument(
        "--cluster",
        metavar="ADDRESS",
        help="Dask scheduler instead, tcp://127.0.0.1:8786 or tls://HOST:8786",
    )
    for option in TLS:
        parser.add_argument(f"--{option}", type=Path, help="of a scheduler on another machine")


@contextlib.contextmanager
def executor(arguments: argparse.Namespace) -> Iterator[Executor]:
    """Open what the jobs run on."""
    if arguments.cluster is None:
        with Workers(arguments.workers or os.cpu_count() or 1) as pool:
            yield pool
        return
    security = check_cluster(arguments)
    if not security:
        _say(
            f"{arguments.cluster}: any user of this machine may hold that port, get the jobs and"
            f" answer them; on a machine with several users, use tls:// with --{', --'.join(TLS)}"
        )
    try:
        import distributed
    except ImportError as error:
        raise UsageError("--cluster needs Dask: pip install 'haptic-nodes[cluster]'") from error
    dask: Any = distributed
    try:
        client = dask.Client(
            arguments.cluster,
            security=dask.Security(**security) if security else None,
            timeout="5s",
        )
    except (OSError, TimeoutError) as error:
        raise RefusedError(
            f"--cluster {arguments.cluster}: no scheduler answers ({error})"
        ) from error
    try:
        if not client.scheduler_info()["workers"]:
            _say(f"{arguments.cluster}: no worker there yet; the jobs wait for the first")
        yield client.get_executor(retries=RETRIES, pure=False)
    finally:
        client.close()


def _say(what: str) -> None:
    print(f"[sweep] {what}", file=sys.stderr, flush=True)


def check_cluster(arguments: argparse.Namespace) -> dict[str, Any]:
    """Refuse a cluster that is reached over a network without TLS: its workers run whatever they are sent."""
    address = urlsplit(arguments.cluster)
    if address.scheme not in ("tcp", "tls") or not address.hostname or not address.port:
        raise UsageError(
            f"--cluster {arguments.cluster}: expected tcp://127.0.0.1:PORT or tls://HOST:PORT"
        )
    given = {name: getattr(arguments, name.replace("-", "_")) for name in TLS}
    if address.scheme == "tcp":
        if is_remote(f"tcp://{address.hostname}:{address.port}"):
            raise UsageError(
                f"--cluster {arguments.cluster}: workers run what they are sent, so off this"
                f" machine TLS is required: tls://{address.hostname}:{address.port} with"
                f" --{', --'.join(TLS)}"
            )
        return {}
    missing = [name for name, path in given.items() if path is None or not path.is_file()]
    if missing:
        raise UsageError(f"--cluster {arguments.cluster}: needs the files --{', --'.join(missing)}")
    return {
        "require_encryption": True,
        "tls_ca_file": str(given["tls-ca-file"]),
        "tls_client_cert": str(given["tls-cert"]),
        "tls_client_key": str(given["tls-key"]),
    }


def swept(
    arguments: argparse.Namespace,
    job: Job,
    jobs: Sequence[Mapping[str, Any]],
    name: str,
    chunk: int = 1,
) -> tuple[list[SweepRow], Path]:
    """Do the jobs of a study, with progress on stderr: rows in their order, and the ledger that holds what was done before."""
    ledger = begun(arguments, name)
    try:
        with executor(arguments) as pool:
            return sweep(job, jobs, pool, ledger, chunk, Progress(len(jobs)).step), ledger
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"what is done is in {ledger}, and the same command goes on there"
        ) from None


def begun(arguments: argparse.Namespace, name: str) -> Path:
    """Name the ledger of a study; with --fresh there is none yet."""
    ledger = Path(arguments.out) / f"{name}.jsonl"
    return fresh(ledger) if arguments.fresh else ledger


def spread(
    arguments: argparse.Namespace,
    jobs: Sequence[Callable[[], R]],
    chunk: int = 1,
    step: Callable[[str, int], None] | None = None,
) -> list[R]:
    """Do all jobs where the arguments say, with progress on stderr: results in the order of the jobs, kept nowhere.

    Each is a `functools.partial` of a module's function, so that other processes find it by name.
    """
    step = step or Progress(len(jobs), after=PATIENCE).step
    results: dict[int, R] = {}

    def note(part: range, rows: list[R]) -> None:
        results.update(zip(part, rows, strict=True))
        step(f"{len(results)} of {len(jobs)}", len(rows))

    if arguments.cluster is None and not arguments.workers:
        for i, job in enumerate(jobs):
            note(range(i, i + 1), [job()])
    else:
        with (
            executor(arguments) as pool,
            contextlib.closing(done_by(pool, call, jobs, chunk)) as done,
        ):
            for part, rows in done:
                note(part, rows)
    return [results[i] for i in range(len(jobs))]
