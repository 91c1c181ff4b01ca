"""Start, query and end a launch as a user does, and return its figures.

Studies, benches, drills and tests start their launches here. ``with Running("floor_drop",
"duration:=0") as launch:`` continues once the driver ticks; ``launch("floor_drop",
"pace:=lockstep")`` runs a launch to its end.
"""

import contextlib
import functools
import json
import os
import subprocess
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Self

import msgspec

from messages import topics
from messages.transport.context import new_context
from messages.transport.requests import ControlError, call
from messages.types import DeviceState
from nodes.launcher.chain_load import OVERLOADED
from nodes.launcher.child import PYTHON
from nodes.launcher.runs import RunInfo, alive
from nodes.recording.summary import quantile
from sim.measure import stopwatch
from sim.measure.haptic_commands import (
    DEADLINE,
    MeasurementError,
    haptic,
    wait_for,
    within,
)
from sim.measure.started_launch import StartedLaunch


def processes_of(runtime_dir: Path) -> dict[int, str]:
    """Return the live processes of all runs below a runtime directory.

    Nodes and reapers have it on their command line.
    """
    found = {}
    for entry in os.listdir("/proc"):
        with contextlib.suppress(FileNotFoundError, ProcessLookupError, ValueError):
            line = Path(f"/proc/{int(entry)}/cmdline").read_bytes()
            if os.fsencode(runtime_dir) in line and alive(int(entry)):
                found[int(entry)] = (
                    line.replace(b"\0", b" ").decode(errors="replace").strip()
                )
    return found


def left_behind(runtime_dir: Path, timeout: float = 10.0) -> list[str]:
    """Return the processes and files of runs that still exist after `timeout` [s]."""
    within(
        lambda: not processes_of(runtime_dir) and not list(runtime_dir.glob("runs/*")),
        timeout,
    )
    processes = [
        f"process {number}: {line}"
        for number, line in processes_of(runtime_dir).items()
    ]
    return processes + [f"file {path}" for path in (runtime_dir / "runs").rglob("*")]


def launch(
    scenario: str, *words: str, folder: Path | None = None, timeout: float = 300.0
) -> dict[str, Any]:
    """Run a scenario to its end; return its figures."""
    with contextlib.ExitStack() as held:
        if folder is None:
            folder = Path(
                held.enter_context(tempfile.TemporaryDirectory(prefix="haptic-"))
            )
        done = haptic(
            folder,
            "launch",
            scenario,
            "--json",
            "--no-plot",
            *words,
            code=None,
            timeout=timeout,
        )
        if done.returncode not in (0, OVERLOADED):
            raise MeasurementError(
                f"haptic launch {scenario} {' '.join(words)}: exit code"
                f" {done.returncode}\n{done.stdout[-1000:]}\n{done.stderr[-2000:]}"
            )
        figures: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
        return figures


@contextlib.contextmanager
def launched(scenario: str, *assignments: str) -> Iterator[RunInfo]:
    """Start a launch that other verbs find, wait for its first ticks, and end it afterwards."""
    with StartedLaunch(scenario, *assignments) as launch:
        launch.await_tick(11)
        found = launch.info()
        if found is None:
            raise MeasurementError(
                f"haptic launch {scenario}: ended at once: {launch.errors}"
            )
        yield found


class Running(StartedLaunch):
    """A launch in the background with its own directories.

    If `ready`, the ``with`` block begins at its first tick.
    """

    def __init__(
        self,
        *words: str,
        folder: Path | None = None,
        environment: Mapping[str, str] | None = None,
        ready: bool = True,
        stderr: int | None = None,
    ) -> None:
        # Short, because the paths of sockets are.
        self._place = tempfile.TemporaryDirectory(
            prefix="hapt-", dir="/tmp", ignore_cleanup_errors=True
        )
        place = Path(self._place.name)
        # Working and runtime directory.
        self.folder = folder or place
        self.runtime_dir = place / "run"
        self.runtime_dir.mkdir(mode=0o700)
        # Variables that lead another ``haptic`` command to this launch.
        self.environment = {
            **os.environ,
            "HAPTIC_RUNTIME_DIR": str(self.runtime_dir),
            **(environment or {}),
        }
        self.context = new_context()  # for sockets beside the launch; ended with it
        self._begin = functools.partial(
            super().__init__,
            *words,
            folder=self.folder,
            environment=self.environment,
            stderr=stderr,
        )
        self._run_dir: Path | None = None
        self._ready = ready

    def __enter__(self) -> Self:
        """Start it, and wait for its first tick."""
        self._begin()
        try:
            if self._ready:
                self.await_tick()
        except BaseException:
            self.close()
            raise
        return self

    def close(self) -> None:
        """End the launch and remove its directories."""
        try:
            super().close()
        finally:
            self.context.destroy(linger=0)
            self._place.cleanup()

    @property
    def run_dir(self) -> Path:
        """Return the run's private directory."""
        if self._run_dir is None:
            self._run_dir = next(iter(self.runtime_dir.glob("runs/*/run.json"))).parent
        return self._run_dir

    @property
    def run(self) -> RunInfo:
        """Return the content of the run's ``run.json``."""
        return msgspec.json.decode(
            (self.run_dir / "run.json").read_bytes(), type=RunInfo
        )

    def call(self, node: str, op: str, timeout: float = 20.0, **args: object) -> Any:
        """Send a request to a node; a refusal raises `ControlError`."""
        return call(
            self.context, self.run.nodes[node].control, op, timeout=timeout, **args
        )

    def pid(self, node: str) -> int:
        """Return a node's process number."""
        return int(self.call(node, "status")["pid"])

    def ticks(self) -> int:
        """Return the driver's tick count (the lowest of several chains); 0 before the first."""
        with contextlib.suppress(ControlError, StopIteration):
            # The slowest of several chains.
            published: dict[str, list[str]] = json.loads(self.run.manifest["publishes"])
            drivers = [
                name
                for name, sent in published.items()
                if any(one.endswith(topics.DEVICE_STATE) for one in sent)
            ]
            return min(
                int(self.call(name, "status", timeout=1.0)["ticks"]) for name in drivers
            )
        return 0

    def wait_ticks(self, more: int) -> int:
        """Wait for `more` ticks; return the tick count."""
        goal = self.ticks() + more
        return int(wait_for(lambda: self._ticks_from(goal), f"tick {goal}"))

    def _ticks_from(self, goal: int) -> int:
        if self.process.poll() is not None:
            raise MeasurementError(
                f"the launch ended with exit code {self.process.returncode}: {self.errors}"
            )
        ticks = self.ticks()
        return ticks if ticks >= goal else 0

    def haptic(
        self, *words: str, code: int | None = 0
    ) -> subprocess.CompletedProcess[str]:
        """Run another ``haptic`` command beside the launch."""
        return haptic(self.folder, *words, code=code, environment=self.environment)

    def finish(self, number: int | None = None, code: int | None = 0) -> dict[str, Any]:
        """Wait for the end, optionally after a signal; return the figures.

        Raise if the exit code is not `code`.
        """
        if number is not None:
            self.process.send_signal(number)
        found = self.process.wait(timeout=DEADLINE)
        if code is not None and found != code:
            raise MeasurementError(
                f"the launch ended with exit code {found}, expected {code}: {self.errors}"
            )
        return self.figures


def responses_in(
    states: Sequence[DeviceState], spans: Sequence[tuple[float, float]]
) -> dict[str, Any]:
    """Summarise a driver's states in some time spans: response [µs] per span, ticks, misses."""
    found: dict[str, Any] = {"p50_us": [], "p99_us": [], "missed": 0, "ticks": 0}
    for began, ended in spans:
        part = [state for state in states if began <= state.stamp <= ended]
        responses = sorted(
            state.response * 1e6 for state in part if state.response > 0.0
        )
        found["p50_us"].append(quantile(responses, 0.5))
        found["p99_us"].append(quantile(responses, 0.99))
        found["missed"] += (
            part[-1].missed - part[0].missed + part[-1].overruns - part[0].overruns
        )
        found["ticks"] += part[-1].seq - part[0].seq
    return found


def machine() -> str:
    """Return a description of this machine."""
    here = stopwatch.machine()
    cores = len(os.sched_getaffinity(0))
    return f"{here['cpu']}, {cores} cores, {here['system']}, Python {here['python']}"


def fifo_granted() -> bool:
    """Whether this user may use real-time priority."""
    code = "import os; os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(50))"
    return (
        subprocess.run(
            [*PYTHON, "-c", code], capture_output=True, check=False
        ).returncode
        == 0
    )
