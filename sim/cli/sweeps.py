"""Where the sweep of a study runs: processes of this machine by default, or the workers of a Dask scheduler (``--cluster``)."""

from __future__ import annotations

import argparse
import contextlib
import multiprocessing
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from ipaddress import ip_address
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import urlsplit

from messages.errors import RefusedError, UsageError
from sim.measure.stopwatch import Progress
from sim.measure.sweep import Job, Row, sweep

TLS = ("tls-ca-file", "tls-cert", "tls-key")
"""Options that hold the certificates of a cluster off this machine."""
RETRIES = 3
"""How often a job is given to another worker when one dies."""


class Study(NamedTuple):
    """Rows of a study in the order of its jobs, and the ledger that holds them."""

    rows: list[Row]
    ledger: Path


def add_sweep(parser: argparse.ArgumentParser) -> None:
    """Declare where a sweep runs, and whether it goes on."""
    parser.add_argument("--fresh", action="store_true", help="begin anew instead of going on where it stopped")
    parser.add_argument("--workers", type=int, default=0, help="processes on this machine (default: one per core)")
    parser.add_argument(
        "--cluster", metavar="ADDRESS", help="Dask scheduler instead, tcp://127.0.0.1:8786 or tls://HOST:8786"
    )
    for option in TLS:
        parser.add_argument(f"--{option}", type=Path, help="of a scheduler on another machine")


@contextlib.contextmanager
def executor(arguments: argparse.Namespace) -> Iterator[Executor]:
    """Open what the jobs run on."""
    if arguments.cluster is None:
        # Spawned, not forked: this process may have threads of its own by now.
        with ProcessPoolExecutor(
            arguments.workers or os.cpu_count() or 1, mp_context=multiprocessing.get_context("spawn")
        ) as pool:
            yield pool
        return
    security = check_cluster(arguments)
    if not security:
        print(
            f"[sweep] {arguments.cluster}: whoever of this machine's users holds that port is given the jobs, and believed; "
            f"where there are others, use tls:// with --{', --'.join(TLS)}",
            file=sys.stderr,
            flush=True,
        )
    try:
        import distributed
    except ImportError as error:
        raise UsageError("--cluster needs Dask: pip install 'haptic-nodes[cluster]'") from error
    dask: Any = distributed
    try:
        client = dask.Client(arguments.cluster, security=dask.Security(**security) if security else None, timeout="5s")
    except (OSError, TimeoutError) as error:
        raise RefusedError(f"--cluster {arguments.cluster}: no scheduler answers ({error})") from error
    try:
        yield client.get_executor(retries=RETRIES, pure=False)
    finally:
        client.close()


def check_cluster(arguments: argparse.Namespace) -> dict[str, Any]:
    """Refuse a cluster that is reached over a network without TLS: its workers run whatever they are sent."""
    address = urlsplit(arguments.cluster)
    if address.scheme not in ("tcp", "tls") or not address.hostname or not address.port:
        raise UsageError(f"--cluster {arguments.cluster}: expected tcp://127.0.0.1:PORT or tls://HOST:PORT")
    given = {name: getattr(arguments, name.replace("-", "_")) for name in TLS}
    if address.scheme == "tcp":
        if not _loopback(address.hostname):
            raise UsageError(
                f"--cluster {arguments.cluster}: workers run what they are sent, so off this machine TLS is required: "
                f"tls://{address.hostname}:{address.port} with --{', --'.join(TLS)}"
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


def _loopback(host: str) -> bool:
    if host == "localhost":
        return True
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return False


def swept(
    arguments: argparse.Namespace, job: Job, jobs: Sequence[Mapping[str, Any]], name: str, chunk: int = 1
) -> Study:
    """Do the jobs of a study as its arguments say, with progress on stderr; what was done before is in its ledger."""
    ledger = begun(arguments, name)
    with executor(arguments) as pool:
        return Study(sweep(job, jobs, pool, ledger, chunk, Progress(len(jobs)).step), ledger)


def begun(arguments: argparse.Namespace, name: str) -> Path:
    """Name the ledger of a study; with --fresh there is none yet."""
    ledger = Path(arguments.out) / f"{name}.jsonl"
    if arguments.fresh:
        ledger.unlink(missing_ok=True)
    return ledger
