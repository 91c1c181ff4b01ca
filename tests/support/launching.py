"""Real launches for the tests: what studies and benches start theirs with, and nothing left behind at the end.

``with running(folder, "floor_drop", "duration:=0") as launch:`` starts ``haptic launch`` and yields it once its driver
ticks; ``launch_json(folder, "floor_drop", "pace:=lockstep")`` runs one to its end. Both assert that no process of the run
outlives it and that its directory is gone.
"""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from sim.measure.measured_launch import DEADLINE, HAPTIC, Running, haptic, left_behind, processes_of, wait_for

__all__ = [
    "DEADLINE",
    "HAPTIC",
    "Running",
    "assert_nothing_left",
    "haptic",
    "launch_json",
    "private_runtime_dir",
    "processes_of",
    "running",
    "wait_for",
]


def assert_nothing_left(runtime_dir: Path) -> None:
    """Assert that no process and no file of any run is left."""
    assert not left_behind(runtime_dir)


@contextlib.contextmanager
def private_runtime_dir() -> Iterator[Path]:
    """Make a runtime directory that no other test sees, mode 0700, short enough for socket paths."""
    with tempfile.TemporaryDirectory(prefix="hapt-", dir="/tmp") as path:  # short: socket paths are
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
    """Run a launch for the length of a with block; see `Running`."""
    with Running(scenario, *assignments, folder=folder, environment=environment, ready=ready, stderr=stderr) as launch:
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
    """Run a launch to its end: the object of ``--json``, whose ``recording`` is relative to `folder`."""
    with running(folder, scenario, *assignments, environment=environment, ready=False) as launch:
        return launch.finish(code=code)
