"""A real Dask cluster of processes: a scheduler, and workers that come and go."""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from tests.support import ROOT


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def own_address() -> str:
    """Return a non-loopback address of this machine, if there is one."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))
        except OSError:
            return "127.0.0.1"
        return str(probe.getsockname()[0])


class DaskCluster:
    """Processes of a cluster; `workers` in the order of their start.

    Parameters
    ----------
    address : str
        Of the scheduler.
    tls : sequence of str
        Options of its certificates; none without TLS.
    folder : Path
        Where they run.
    """

    def __init__(self, address: str, tls: Sequence[str], folder: Path) -> None:
        self.address, self.tls, self.folder = address, list(tls), folder
        self.workers: list[subprocess.Popen[bytes]] = []
        self.scheduler: subprocess.Popen[bytes]

    def start(
        self, what: str, *words: str, root: Path = ROOT
    ) -> subprocess.Popen[bytes]:
        """Start one of its processes; its output goes to a file."""
        environment = {
            **os.environ,
            "PYTHONPATH": str(root),
            "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "3",
            "PYTHONWARNINGS": "ignore",
        }
        with open(self.folder / f"{what}-{time.monotonic_ns()}.log", "wb") as log:
            return subprocess.Popen(
                [
                    sys.executable,
                    "-m",
                    f"distributed.cli.dask_{what}",
                    *words,
                    "--no-dashboard",
                    *self.tls,
                ],
                env=environment,
                stdout=log,
                stderr=log,
                cwd=self.folder,
            )

    def add_worker(self, root: Path = ROOT) -> subprocess.Popen[bytes]:
        """Start a worker with one thread, without a nanny that would restart it."""
        words = ("--nthreads", "1", "--no-nanny", "--local-directory", str(self.folder))
        self.workers.append(self.start("worker", self.address, *words, root=root))
        return self.workers[-1]

    def options(self) -> list[str]:
        """Return the options of a study that uses the cluster."""
        return ["--cluster", self.address, *self.tls]


def keywords(words: Sequence[str]) -> dict[str, str]:
    """Write options as keywords: ``--tls-key FILE`` is ``tls_key=FILE``."""
    return {
        flag.lstrip("-").replace("-", "_"): value
        for flag, value in zip(words[::2], words[1::2], strict=True)
    }


@contextlib.contextmanager
def dask_cluster(
    folder: Path, host: str = "127.0.0.1", tls: Sequence[str] = (), workers: int = 2
) -> Iterator[DaskCluster]:
    """Start a scheduler and workers; stop all afterwards."""
    protocol, port = "tls" if tls else "tcp", free_port()
    found = DaskCluster(f"{protocol}://{host}:{port}", tls, folder)
    found.scheduler = found.start(
        "scheduler", "--protocol", protocol, "--host", host, "--port", str(port)
    )
    try:
        for _ in range(workers):
            found.add_worker()
        yield found
    finally:
        for process in (found.scheduler, *found.workers):
            process.kill()
            process.wait()
