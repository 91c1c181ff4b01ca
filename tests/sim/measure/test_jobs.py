"""Sweeps continue where they stopped, survive dead workers, and require TLS remotely."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from messages.errors import RefusedError, UsageError
from nodes.launcher.runs import alive
from sim.measure.jobs import key_of, read_ledger, sweep
from sim.studies.sweeps import SpreadOptions, check_cluster, executor
from tests.support.dask_cluster import DaskCluster, dask_cluster, keywords, own_address
from tests.support.launching import DEADLINE, HAPTIC, wait_for


def square(job: Mapping[str, Any]) -> dict[str, Any]:
    return {"square": job["x"] ** 2, "pid": os.getpid()}


def slow_square(job: Mapping[str, Any]) -> dict[str, Any]:
    """Signal the start, and wait for permission: a job that is certainly running."""
    folder = Path(job["folder"])
    (folder / f"{job['x']}-{os.getpid()}").touch()
    wait_for((folder / "go").exists, "the word to go on")
    return {"square": job["x"] ** 2, "pid": os.getpid()}


JOBS = [{"x": x} for x in range(7)]
SQUARES = [x**2 for x in range(7)]


def options(*words: str) -> SpreadOptions:
    return SpreadOptions.of(**keywords(words))


def squares(rows: list[dict[str, Any]]) -> list[int]:
    return [row["square"] for row in rows]


class Counting(ThreadPoolExecutor):
    """An executor that counts its jobs."""

    given = 0

    def submit(self, *args: Any, **kwargs: Any) -> Future[Any]:
        """Count and run a job."""
        self.given += 1
        return super().submit(*args, **kwargs)


@pytest.mark.process
@pytest.mark.smoke
def test_workers_die_alone_hear_no_ctrl_c_and_end_when_nobody_wants_them(
    tmp_path: Path,
) -> None:
    jobs = [{"x": x, "folder": str(tmp_path)} for x in range(7)]

    def begun() -> set[int]:
        return {int(mark.name.split("-")[1]) for mark in tmp_path.glob("*-*")}

    with executor(options("--workers", "2")) as pool:
        with ThreadPoolExecutor(1) as beside:
            result = beside.submit(sweep, slow_square, jobs, pool, tmp_path / "l.jsonl")
            wait_for(lambda: len(begun()) == 2, "both workers to be at work")
            first, second = begun()
            os.kill(first, signal.SIGKILL)
            os.kill(second, signal.SIGINT)
            wait_for(
                lambda: len(begun()) == 3, "another in the place of the killed one"
            )
            (tmp_path / "go").touch()
            rows = result.result(timeout=120.0)
        assert squares(rows) == SQUARES
        assert {row["pid"] for row in rows} <= begun() - {first}
        with pytest.raises(TypeError, match="unsupported operand"):
            pool.submit(square, {"x": "three"}).result()
        with pytest.raises(TypeError, match="cannot be sent back"):
            pool.submit(open, os.devnull).result()
    wait_for(lambda: not any(alive(pid) for pid in begun()), "the workers end")
    (tmp_path / "go").unlink()
    before = begun()

    def interrupted() -> None:
        with executor(options("--workers", "2")) as pool:
            pool.submit(slow_square, jobs[0])
            wait_for(lambda: begun() - before, "a worker to be at work")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    wait_for(lambda: not any(alive(pid) for pid in begun()), "the workers end")


@pytest.mark.process
def test_ctrl_c_ends_a_study_with_its_workers_in_one_line(tmp_path: Path) -> None:
    words = [
        *HAPTIC,
        "lab",
        "coverage",
        "--devices",
        "400",
        "--workers",
        "2",
        "--out",
        str(tmp_path),
    ]
    # In the background of a script Ctrl-C is ignored, and every process that the tests start would
    # inherit that.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    study = subprocess.Popen(
        words,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        process_group=0,
    )
    signal.signal(signal.SIGINT, before)

    def children() -> list[int]:
        listed = Path(f"/proc/{study.pid}/task").glob("*/children")
        return [int(child) for path in listed for child in path.read_text().split()]

    workers = wait_for(
        lambda: len(found := children()) == 2 and found, "its workers are started"
    )
    os.killpg(study.pid, signal.SIGINT)
    try:
        told, complaint = study.communicate(timeout=DEADLINE)
    finally:
        study.kill()
    assert (study.returncode, told) == (130, "")
    kept = f"what is done is in {tmp_path / 'coverage.jsonl'}, and the same command goes on there"
    assert complaint == f"haptic: lab coverage was interrupted: {kept}\n"
    wait_for(lambda: not any(alive(pid) for pid in workers), "its workers end")


def test_an_interrupted_sweep_goes_on_where_it_stopped(tmp_path: Path) -> None:
    ledger = tmp_path / "l.jsonl"
    with Counting(1) as pool:
        sweep(square, JOBS[:3], pool, ledger)
        # Killed while it wrote: the last line is cut, and that job is done again.
        ledger.write_text(ledger.read_text()[:-9])
        assert len(read_ledger(ledger)) == 2
        pool.given = 0
        assert squares(sweep(square, JOBS, pool, ledger)) == SQUARES
        assert pool.given == 5
        pool.given = 0
        assert (
            squares(sweep(square, list(reversed(JOBS)), pool, ledger)) == SQUARES[::-1]
        )
        assert pool.given == 0
    # Other parameters are another job.
    assert key_of({"x": 1, "y": 2}) == key_of({"y": 2, "x": 1}) != key_of({"x": 1})


class AtOnce(Executor):
    """All jobs are done when the first is waited for, in whatever order a set has."""

    def submit(self, job: Any, /, *words: Any, **named: Any) -> Future[Any]:
        """Run a job at once."""
        future: Future[Any] = Future()
        try:
            future.set_result(job(*words, **named))
        except TypeError as error:
            future.set_exception(error)
        return future


@pytest.mark.parametrize("failing", range(4))
@pytest.mark.parametrize("kind", [AtOnce, lambda: ThreadPoolExecutor(1)])
def test_what_is_done_is_kept_when_a_job_fails(
    failing: int, kind: Callable[[], Executor], tmp_path: Path
) -> None:
    jobs: list[dict[str, Any]] = [*JOBS[:3]]
    jobs.insert(failing, {"x": "three"})
    with kind() as pool, pytest.raises(TypeError):
        sweep(square, jobs, pool, tmp_path / "l.jsonl")
    # Those before it, and all of them if they were done with it.
    assert len(read_ledger(tmp_path / "l.jsonl")) >= (3 if kind is AtOnce else failing)


@pytest.mark.parametrize(
    ("address", "message"),
    [
        (
            "tcp://192.0.2.7:8786",
            r"off this machine TLS is required: tls://192\.0\.2\.7:8786",
        ),
        ("tcp://scheduler:8786", "TLS is required"),
        (
            "tls://scheduler:8786",
            r"needs the files --tls-ca-file, --tls-cert, --tls-key",
        ),
        ("http://127.0.0.1:80", r"expected tcp://127\.0\.0\.1:PORT"),
        ("tcp://127.0.0.1", "expected tcp"),
    ],
)
def test_a_cluster_off_this_machine_needs_tls(address: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        check_cluster(options("--cluster", address))


@pytest.mark.parametrize(
    "address", ["tcp://127.0.0.1:8786", "tcp://localhost:8786", "tcp://[::1]:8786"]
)
def test_on_this_machine_it_does_not(address: str) -> None:
    assert check_cluster(options("--cluster", address)) == {}


def test_tls_files_are_handed_on(tmp_path: Path) -> None:
    files = {name: tmp_path / name for name in ("tls-ca-file", "tls-cert", "tls-key")}
    for file in files.values():
        file.touch()
    words = [word for name, file in files.items() for word in (f"--{name}", str(file))]
    security = check_cluster(options("--cluster", "tls://scheduler:8786", *words))
    assert security["require_encryption"] is True
    assert security["tls_ca_file"] == str(files["tls-ca-file"])


def certificate(folder: Path) -> list[str]:
    """Create a self-signed certificate; return options of scheduler and workers."""
    key, signed = folder / "key.pem", folder / "cert.pem"
    words = [
        "openssl",
        "req",
        "-x509",
        "-newkey",
        "ec",
        "-pkeyopt",
        "ec_paramgen_curve:P-256",
        "-nodes",
        "-days",
        "2",
    ]
    subprocess.run(
        [*words, "-subj", "/CN=sweep", "-keyout", key, "-out", signed],
        check=True,
        capture_output=True,
    )
    return [
        "--tls-ca-file",
        str(signed),
        "--tls-cert",
        str(signed),
        "--tls-key",
        str(key),
    ]


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[DaskCluster]:
    """Start a real scheduler and two workers with certificates, off loopback."""
    if shutil.which("openssl") is None:
        pytest.skip("no openssl here, which makes the certificates")
    with dask_cluster(tmp_path, own_address(), certificate(tmp_path)) as found:
        yield found


def open_when_there(words: list[str]) -> Any:
    """Wait for the scheduler, which takes seconds to import."""
    until = time.monotonic() + 60.0
    while True:
        opened = executor(options(*words))
        try:
            return opened, opened.__enter__()
        except RefusedError:
            assert time.monotonic() < until


@pytest.mark.slow
def test_a_cluster_with_tls_of_which_one_worker_is_killed_and_the_sweep_interrupted(
    cluster: DaskCluster, tmp_path: Path
) -> None:
    words, workers = cluster.options(), cluster.workers
    opened, pool = open_when_there(words)
    assert isinstance(pool, Executor)
    (tmp_path / "marks").mkdir()
    jobs = [{"x": x, "folder": str(tmp_path / "marks")} for x in range(6)]
    ledger = tmp_path / "l.jsonl"

    def begun() -> set[int]:
        return {
            int(mark.name.split("-")[1]) for mark in (tmp_path / "marks").glob("*-*")
        }

    def ctrl_c(*_: object) -> None:
        raise KeyboardInterrupt

    with ThreadPoolExecutor(1) as beside:
        result = beside.submit(sweep, slow_square, jobs, pool, ledger, step=ctrl_c)
        wait_for(lambda: len(begun()) == 2, "both workers to be at work")
        workers[0].send_signal(signal.SIGKILL)
        workers[0].wait()
        (tmp_path / "marks" / "go").touch()
        # Interrupted as soon as there is a result: what is done is kept, what has not begun is not.
        with pytest.raises(KeyboardInterrupt):
            result.result(timeout=120.0)
    before = read_ledger(ledger)
    assert 1 <= len(before) < 6
    rows = sweep(slow_square, jobs, pool, ledger)
    opened.__exit__(None, None, None)
    assert squares(rows) == SQUARES[:6]
    # All by the one that is left, and none of them twice.
    assert {row["pid"] for row in rows} == {workers[1].pid}
    assert len(ledger.read_text().splitlines()) == 6
    # Who has no certificate of that authority is not let in.
    (tmp_path / "other").mkdir()
    with (
        pytest.raises(RefusedError, match="no scheduler answers"),
        executor(options("--cluster", words[1], *certificate(tmp_path / "other"))),
    ):
        pass


def test_ledger_lines_are_json(tmp_path: Path) -> None:
    with ThreadPoolExecutor(1) as pool:
        sweep(square, JOBS[:1], pool, tmp_path / "l.jsonl")
    (line,) = (tmp_path / "l.jsonl").read_text().splitlines()
    assert json.loads(line)["job"] == {"x": 0}
