"""Real launches for the tests, started as studies do, with nothing left behind.

``with running(folder, "floor_drop", "duration:=0") as launch:`` starts ``haptic launch`` and yields
it once its driver ticks; ``launch_json(folder, "floor_drop", "pace:=lockstep")`` runs one to its
end. Both assert that no process of the run outlives it and that its directory is gone.
"""

from __future__ import annotations

import contextlib
import io
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import IO, Any

import pytest

from nodes.base.stderr_queue import STDERR, drain_stderr
from nodes.cli.main import main
from sim.measure.haptic_commands import DEADLINE, HAPTIC, haptic, wait_for
from sim.measure.measured_launch import Running, left_behind, processes_of

__all__ = [
    "DEADLINE",
    "HAPTIC",
    "Running",
    "assert_nothing_left",
    "exit_code",
    "haptic",
    "launch_json",
    "private_runtime_dir",
    "processes_of",
    "running",
    "typed",
    "typed_in",
    "wait_for",
]


def assert_nothing_left(runtime_dir: Path) -> None:
    """Assert that no process and no file of any run is left."""
    assert not left_behind(runtime_dir)


@contextlib.contextmanager
def private_runtime_dir() -> Iterator[Path]:
    """Create a private runtime directory (mode 0700) with a path short enough for sockets."""
    # short: socket paths are
    with tempfile.TemporaryDirectory(prefix="hapt-", dir="/tmp") as path:
        yield Path(path)


@contextlib.contextmanager
def running(
    folder: Path,
    scenario: str,
    *assignments: str,
    environment: Mapping[str, str] | None = None,
    ready: bool = True,
    stderr: int | None = None,
) -> Iterator[Running]:
    """Run a launch for a with block; see `Running`."""
    with Running(
        scenario,
        *assignments,
        folder=folder,
        environment=environment,
        ready=ready,
        stderr=stderr,
    ) as launch:
        yield launch
        launch.interrupt()
        assert_nothing_left(launch.runtime_dir)


def launch_json(
    folder: Path,
    scenario: str,
    *assignments: str,
    code: int = 0,
    environment: Mapping[str, str] | None = None,
) -> dict[str, Any]:
    """Run a launch to its end; return the object of ``--json``.

    Its ``recording`` is relative to `folder`.
    """
    with running(
        folder, scenario, *assignments, environment=environment, ready=False
    ) as launch:
        return launch.finish(code=code)


def exit_code(*words: str) -> int:
    """Run a verb in this process; return its exit code, also for words the parser refuses."""
    try:
        return main(list(words))
    except SystemExit as ended:
        return ended.code if isinstance(ended.code, int) else 1


def typed(
    launch: Running, *words: str, code: int | None = 0
) -> subprocess.CompletedProcess[str]:
    """Run a verb beside a launch in this process; see `typed_in` and `Running.haptic`."""
    return typed_in(launch.folder, *words, code=code, environment=launch.environment)


@contextlib.contextmanager
def _stderr_into(file: IO[bytes]) -> Iterator[None]:
    """Redirect standard error to a file, including writes to its descriptor."""
    sys.stderr.flush()
    before = os.dup(STDERR)
    os.dup2(file.fileno(), STDERR)
    try:
        with (
            open(
                STDERR, "w", encoding="utf-8", errors="replace", closefd=False
            ) as stream,
            contextlib.redirect_stderr(stream),
        ):
            yield
            drain_stderr()
    finally:
        os.dup2(before, STDERR)
        os.close(before)


def typed_in(
    folder: Path,
    *words: str,
    code: int | None = 0,
    environment: Mapping[str, str] | None = None,
) -> subprocess.CompletedProcess[str]:
    """Run a verb in this process: starting a new one costs half a second.

    For a verb's texts, requests, results and refusals. Tests of signals, pipes and start-up need a
    real process.
    """
    out = io.StringIO()
    with tempfile.TemporaryFile() as told:
        with (
            pytest.MonkeyPatch.context() as patched,
            contextlib.chdir(folder),
            contextlib.redirect_stdout(out),
            _stderr_into(told),
        ):
            for name, value in (environment or {}).items():
                patched.setenv(name, value)
            found = exit_code(*words)
        told.seek(0)
        err = told.read().decode(errors="replace")
    done = subprocess.CompletedProcess(["haptic", *words], found, out.getvalue(), err)
    assert code is None or found == code, (
        f"{done.args}: exit code {found}, expected {code}\n{done.stderr}"
    )
    return done
