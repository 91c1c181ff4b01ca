"""Launches from outside: a scenario started as a user starts it, asked, ended as Ctrl-C ends it, and answered as figures.

Studies, benches, drills and tests start their launches here. ``with Running("floor_drop",
"duration:=0") as launch:`` goes on once the driver ticks; ``launch("floor_drop",
"pace:=lockstep")`` runs one to its end.
"""

import contextlib
import functools
import json
import os
import signal
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import msgspec

from messages import topics
from messages.errors import HapticError
from messages.transport.context import new_context
from messages.transport.requests import ControlError, call
from messages.types import DeviceState
from nodes.base.realtime import die_with_parent
from nodes.client.launches import ask, roles
from nodes.launcher.chain_load import OVERLOADED
from nodes.launcher.child import PYTHON
from nodes.launcher.runs import RunInfo, alive, runs
from nodes.recording.summary import quantile
from sim.measure import stopwatch

HAPTIC = (*PYTHON, "-m", "nodes.cli.command")  # the command ``haptic`` with this interpreter
# when a condition that must come about is given up [s]: a bound for what hangs, not a measure of
# anything
DEADLINE = 180.0
# how long a command may take that compiles its loop first, on a busy machine [s]
PATIENCE = 3.0 * DEADLINE


class MeasurementError(HapticError):
    """A launch or a yardstick that was to be measured failed; the text holds what it said."""


def within(condition: Callable[[], Any], longest: float) -> Any:
    """Poll until a condition is true, or the time is over [s]; its last result."""
    until = time.monotonic() + longest
    while not (found := condition()) and time.monotonic() < until:
        time.sleep(0.02)
    return found


def wait_for(condition: Callable[[], Any], what: str, deadline: float = DEADLINE) -> Any:
    """Poll until a condition is true; its first true result."""
    found = within(condition, deadline)
    if not found:
        raise MeasurementError(f"{what}: not within {deadline:g} s")
    return found


def processes_of(runtime_dir: Path) -> dict[int, str]:
    """List the live processes of all runs below a runtime directory: nodes and reapers name it on their command line."""
    found = {}
    for entry in os.listdir("/proc"):
        with contextlib.suppress(FileNotFoundError, ProcessLookupError, ValueError):
            line = Path(f"/proc/{int(entry)}/cmdline").read_bytes()
            if os.fsencode(runtime_dir) in line and alive(int(entry)):
                found[int(entry)] = line.replace(b"\0", b" ").decode(errors="replace").strip()
    return found


def left_behind(runtime_dir: Path, longest: float = 10.0) -> list[str]:
    """List processes and files of runs that are still there after a while [s]."""
    within(lambda: not processes_of(runtime_dir) and not list(runtime_dir.glob("runs/*")), longest)
    processes = [f"process {number}: {line}" for number, line in processes_of(runtime_dir).items()]
    return processes + [f"file {path}" for path in (runtime_dir / "runs").rglob("*")]


def haptic(
    folder: Path,
    *words: str,
    code: int | None = 0,
    environment: Mapping[str, str] | None = None,
    timeout: float = PATIENCE,
) -> subprocess.CompletedProcess[str]:
    """Run one ``haptic`` command to its end in a folder; an exit code other than `code` raises, None lets any pass."""
    done = subprocess.run(
        [*HAPTIC, *words],
        cwd=folder,
        env=None if environment is None else dict(environment),
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=timeout,
        check=False,
    )
    if code is not None and done.returncode != code:
        output = f"haptic {' '.join(words)}: exit code {done.returncode}, expected {code}"
        raise MeasurementError(f"{output}\n{done.stdout[-1000:]}\n{done.stderr[-2000:]}")
    return done


def launch(
    scenario: str, *words: str, folder: Path | None = None, timeout: float = 300.0
) -> dict[str, Any]:
    """Run a scenario to its end."""
    with contextlib.ExitStack() as held:
        if folder is None:
            folder = Path(held.enter_context(tempfile.TemporaryDirectory(prefix="haptic-")))
        done = haptic(
            folder, "launch", scenario, "--json", "--no-plot", *words, code=None, timeout=timeout
        )
        if done.returncode not in (0, OVERLOADED):
            raise MeasurementError(
                f"haptic launch {scenario} {' '.join(words)}: exit code"
                f" {done.returncode}\n{done.stdout[-1000:]}\n{done.stderr[-2000:]}"
            )
        figures: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
        return figures


_STARTER = ThreadPoolExecutor(1, "starter")  # starts processes for threads that may end before them


def beside(*words: str, **options: Any) -> subprocess.Popen[Any]:
    """Start a ``haptic`` command, out of Ctrl-C's reach, that ends with this process, even by SIGKILL."""
    options.setdefault("stdin", subprocess.DEVNULL)
    start = functools.partial(subprocess.Popen, [*HAPTIC, *words], process_group=0, **options)
    start.keywords["preexec_fn"] = functools.partial(die_with_parent, os.getpid())
    # To the kernel the end of the thread that started a process is that of its parent.
    return (
        start()
        if threading.current_thread() is threading.main_thread()
        else _STARTER.submit(start).result()
    )


@contextlib.contextmanager
def launched(scenario: str, *assignments: str) -> Iterator[RunInfo]:
    """Start a launch where the user's other verbs find it, wait for its first ticks, and end it afterwards."""
    words = [scenario, *assignments]
    with tempfile.TemporaryFile() as output:
        process = beside(
            "launch", *words, "--json", "--no-plot", stdout=subprocess.DEVNULL, stderr=output
        )

        def ticking() -> RunInfo | None:
            run = next((run for run in runs().values() if run.launcher == process.pid), None)
            driver = None if run is None else roles(run).get("driver")
            if run is not None and driver is not None:
                with contextlib.suppress(ControlError):
                    return run if ask(run, driver, "status", timeout=1.0)["ticks"] > 10 else None
            return None

        try:
            found = within(lambda: process.poll() is not None or ticking(), DEADLINE)
            if not isinstance(found, RunInfo):
                output.seek(0)
                errors = output.read().decode(errors="replace")[-1000:].strip()
                raise MeasurementError(f"haptic launch {' '.join(words)} did not start: {errors}")
            yield found
        finally:
            end(process)


def end(process: subprocess.Popen[Any], patience: float = DEADLINE) -> None:
    """End a command, first of its process group, as Ctrl-C does; kill it and what it started if that takes too long [s]."""
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(patience)
        except BaseException as error:
            # A cell that was interrupted leaves nothing behind, even one that is interrupted twice.
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            if not isinstance(error, subprocess.TimeoutExpired):
                raise


class Running:
    """A launch in the background, with directories of its own; the ``with`` block begins at its first tick, if `ready`."""

    # The launcher, in a process group of its own, so that it can be sent what Ctrl-C on a terminal
    # sends.
    process: subprocess.Popen[bytes]

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
        self._words = words
        self._run_dir: Path | None = None
        self._ready = ready
        self._stderr = stderr

    def __enter__(self) -> Self:
        """Start it, and wait for its first tick."""
        with (
            open(self.folder / "stdout.txt", "wb") as out,
            open(self.folder / "stderr.txt", "wb") as errors,
        ):
            told = {"stdout": out, "stderr": errors if self._stderr is None else self._stderr}
            self.process = beside(
                "launch",
                *self._words,
                "--json",
                "--no-plot",
                cwd=self.folder,
                env=self.environment,
                **told,
            )
        try:
            if self._ready:
                if not within(
                    lambda: self.process.poll() is not None or self.ticks() > 0, DEADLINE
                ):
                    raise MeasurementError(
                        f"the first tick: not within {DEADLINE:g} s: {self.errors}"
                    )
                if self.process.poll():
                    raise MeasurementError(
                        f"the launch ended with exit code {self.process.returncode}: {self.errors}"
                    )
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Leave nothing behind."""
        self.close()

    def interrupt(self, patience: float = DEADLINE) -> None:
        """End the launch as Ctrl-C does, if it still goes on, and kill it if that takes too long [s]."""
        end(self.process, patience)

    def close(self) -> None:
        """End the launch and remove its directories."""
        try:
            self.interrupt()
        finally:
            self.context.destroy(linger=0)
            self._place.cleanup()

    @property
    def errors(self) -> str:
        """What launcher and nodes wrote to standard error so far."""
        return (self.folder / "stderr.txt").read_text(encoding="utf-8", errors="replace")

    @property
    def figures(self) -> dict[str, Any]:
        """The object of ``--json``; empty before the end."""
        lines = (self.folder / "stdout.txt").read_text(encoding="utf-8").splitlines()
        found: dict[str, Any] = json.loads(lines[-1]) if lines else {}
        return found

    @property
    def run_dir(self) -> Path:
        """The run's private directory; another launch may be started beside this one later."""
        if self._run_dir is None:
            self._run_dir = next(iter(self.runtime_dir.glob("runs/*/run.json"))).parent
        return self._run_dir

    @property
    def run(self) -> RunInfo:
        """The run's ``run.json``."""
        return msgspec.json.decode((self.run_dir / "run.json").read_bytes(), type=RunInfo)

    def call(self, node: str, op: str, timeout: float = 20.0, **args: object) -> Any:
        """Ask a node, as the command line does; a refusal raises `ControlError`."""
        return call(self.context, self.run.nodes[node].control, op, timeout=timeout, **args)

    def pid(self, node: str) -> int:
        """Find a node's process."""
        return int(self.call(node, "status")["pid"])

    def ticks(self) -> int:
        """Count the driver's ticks; 0 before the first one."""
        with contextlib.suppress(ControlError, StopIteration):
            # Of several chains the slowest.
            published: dict[str, list[str]] = json.loads(self.run.manifest["publishes"])
            drivers = [
                name
                for name, sent in published.items()
                if any(one.endswith(topics.DEVICE_STATE) for one in sent)
            ]
            return min(int(self.call(name, "status", timeout=1.0)["ticks"]) for name in drivers)
        return 0

    def wait_ticks(self, more: int) -> int:
        """Wait until the driver has done some more ticks; how many it has done then."""
        goal = self.ticks() + more
        return int(wait_for(lambda: self._ticks_from(goal), f"tick {goal}"))

    def _ticks_from(self, goal: int) -> int:
        if self.process.poll() is not None:
            raise MeasurementError(
                f"the launch ended with exit code {self.process.returncode}: {self.errors}"
            )
        ticks = self.ticks()
        return ticks if ticks >= goal else 0

    def haptic(self, *words: str, code: int | None = 0) -> subprocess.CompletedProcess[str]:
        """Run another ``haptic`` command beside the launch."""
        return haptic(self.folder, *words, code=code, environment=self.environment)

    def finish(self, number: int | None = None, code: int | None = 0) -> dict[str, Any]:
        """Wait for the end, which a signal may bring about, and collect the figures; an exit code other than `code` raises."""
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
    """Sum up what a driver published in some spans of time [s]: response in each [µs], all ticks, those missed or left out."""
    found: dict[str, Any] = {"p50_us": [], "p99_us": [], "missed": 0, "ticks": 0}
    for began, ended in spans:
        part = [state for state in states if began <= state.stamp <= ended]
        responses = sorted(state.response * 1e6 for state in part if state.response > 0.0)
        found["p50_us"].append(quantile(responses, 0.5))
        found["p99_us"].append(quantile(responses, 0.99))
        found["missed"] += part[-1].missed - part[0].missed + part[-1].overruns - part[0].overruns
        found["ticks"] += part[-1].seq - part[0].seq
    return found


def machine() -> str:
    """Name the machine that a figure was measured on."""
    here = stopwatch.machine()
    cores = len(os.sched_getaffinity(0))
    return f"{here['cpu']}, {cores} cores, {here['system']}, Python {here['python']}"


def fifo_granted() -> bool:
    """Whether this user may have real-time priority."""
    code = "import os; os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(50))"
    return subprocess.run([*PYTHON, "-c", code], capture_output=True, check=False).returncode == 0
