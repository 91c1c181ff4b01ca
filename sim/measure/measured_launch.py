"""Start, query and end a launch as a user does, and return its figures.

Studies, benches, drills and tests start their launches here. ``with Running("floor_drop",
"duration:=0") as launch:`` continues once the driver ticks; ``launch("floor_drop",
"pace:=lockstep")`` runs a launch to its end.
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
# Time limit of every wait: detects hangs, measures nothing [s].
DEADLINE = 180.0
# Time limit of a command that first compiles its loop, on a busy machine [s].
COMPILE_TIMEOUT = 3.0 * DEADLINE


class MeasurementError(HapticError):
    """A launch or a yardstick to be measured failed; the text contains its output."""


def within(condition: Callable[[], Any], timeout: float) -> Any:
    """Poll a condition until it is true or `timeout` has passed [s]; return its last result."""
    until = time.monotonic() + timeout
    while not (found := condition()) and time.monotonic() < until:
        time.sleep(0.02)
    return found


def wait_for(condition: Callable[[], Any], what: str, deadline: float = DEADLINE) -> Any:
    """Poll a condition until it is true; return its first true result."""
    found = within(condition, deadline)
    if not found:
        raise MeasurementError(f"{what}: not within {deadline:g} s")
    return found


def processes_of(runtime_dir: Path) -> dict[int, str]:
    """Return the live processes of all runs below a runtime directory.

    Nodes and reapers have it on their command line.
    """
    found = {}
    for entry in os.listdir("/proc"):
        with contextlib.suppress(FileNotFoundError, ProcessLookupError, ValueError):
            line = Path(f"/proc/{int(entry)}/cmdline").read_bytes()
            if os.fsencode(runtime_dir) in line and alive(int(entry)):
                found[int(entry)] = line.replace(b"\0", b" ").decode(errors="replace").strip()
    return found


def left_behind(runtime_dir: Path, timeout: float = 10.0) -> list[str]:
    """Return the processes and files of runs that still exist after `timeout` [s]."""
    within(lambda: not processes_of(runtime_dir) and not list(runtime_dir.glob("runs/*")), timeout)
    processes = [f"process {number}: {line}" for number, line in processes_of(runtime_dir).items()]
    return processes + [f"file {path}" for path in (runtime_dir / "runs").rglob("*")]


def haptic(
    folder: Path,
    *words: str,
    code: int | None = 0,
    environment: Mapping[str, str] | None = None,
    timeout: float = COMPILE_TIMEOUT,
) -> subprocess.CompletedProcess[str]:
    """Run a ``haptic`` command in a folder; raise if its exit code is not `code`.

    With `code` None any exit code is accepted.
    """
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
    """Run a scenario to its end; return its figures."""
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


def start_command(*words: str, **options: Any) -> subprocess.Popen[Any]:
    """Start a ``haptic`` command in its own process group.

    It is killed when this process dies, even by SIGKILL.
    """
    options.setdefault("stdin", subprocess.DEVNULL)
    start = functools.partial(subprocess.Popen, [*HAPTIC, *words], process_group=0, **options)
    start.keywords["preexec_fn"] = functools.partial(die_with_parent, os.getpid())
    # The kernel treats the end of the starting thread as the parent's death.
    return (
        start()
        if threading.current_thread() is threading.main_thread()
        else _STARTER.submit(start).result()
    )


@contextlib.contextmanager
def launched(scenario: str, *assignments: str) -> Iterator[RunInfo]:
    """Start a launch visible to the user's other commands; end it after the block."""
    words = [scenario, *assignments]
    with tempfile.TemporaryFile() as output:
        process = start_command(
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


def end(process: subprocess.Popen[Any], timeout: float = DEADLINE) -> None:
    """Interrupt a command that leads its process group; kill the group after `timeout` [s]."""
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(timeout)
        except BaseException as error:
            # Clean up even if a notebook cell is interrupted twice.
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            if not isinstance(error, subprocess.TimeoutExpired):
                raise


class Running:
    """A launch in the background with its own directories.

    If `ready`, the ``with`` block begins at its first tick.
    """

    # The launcher, in its own process group, so that it can be sent SIGINT.
    process: subprocess.Popen[bytes]

    def __init__(
        self,
        *words: str,
        folder: Path | None = None,
        environment: Mapping[str, str] | None = None,
        ready: bool = True,
        stderr: int | None = None,
    ) -> None:
        # A short path, because socket paths are limited.
        self._place = tempfile.TemporaryDirectory(
            prefix="hapt-", dir="/tmp", ignore_cleanup_errors=True
        )
        place = Path(self._place.name)
        # Working and runtime directory.
        self.folder = folder or place
        self.runtime_dir = place / "run"
        self.runtime_dir.mkdir(mode=0o700)
        # Environment in which other ``haptic`` commands find this launch.
        self.environment = {
            **os.environ,
            "HAPTIC_RUNTIME_DIR": str(self.runtime_dir),
            **(environment or {}),
        }
        self.context = new_context()  # for sockets to the launch; closed with it
        self._words = words
        self._run_dir: Path | None = None
        self._ready = ready
        self._stderr = stderr

    def __enter__(self) -> Self:
        """Start the launch and wait for its first tick."""
        with (
            open(self.folder / "stdout.txt", "wb") as out,
            open(self.folder / "stderr.txt", "wb") as errors,
        ):
            told = {"stdout": out, "stderr": errors if self._stderr is None else self._stderr}
            self.process = start_command(
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
        """End the launch and remove its directories."""
        self.close()

    def interrupt(self, timeout: float = DEADLINE) -> None:
        """End the launch as Ctrl-C does, if it still runs; kill it after `timeout` [s]."""
        end(self.process, timeout)

    def close(self) -> None:
        """End the launch and remove its directories."""
        try:
            self.interrupt()
        finally:
            self.context.destroy(linger=0)
            self._place.cleanup()

    @property
    def errors(self) -> str:
        """Return what launcher and nodes wrote to standard error so far."""
        return (self.folder / "stderr.txt").read_text(encoding="utf-8", errors="replace")

    @property
    def figures(self) -> dict[str, Any]:
        """Return the object of ``--json``; empty before the end."""
        lines = (self.folder / "stdout.txt").read_text(encoding="utf-8").splitlines()
        found: dict[str, Any] = json.loads(lines[-1]) if lines else {}
        return found

    @property
    def run_dir(self) -> Path:
        """Return the run's private directory."""
        if self._run_dir is None:
            self._run_dir = next(iter(self.runtime_dir.glob("runs/*/run.json"))).parent
        return self._run_dir

    @property
    def run(self) -> RunInfo:
        """Return the content of the run's ``run.json``."""
        return msgspec.json.decode((self.run_dir / "run.json").read_bytes(), type=RunInfo)

    def call(self, node: str, op: str, timeout: float = 20.0, **args: object) -> Any:
        """Send a request to a node; a refusal raises `ControlError`."""
        return call(self.context, self.run.nodes[node].control, op, timeout=timeout, **args)

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
            return min(int(self.call(name, "status", timeout=1.0)["ticks"]) for name in drivers)
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

    def haptic(self, *words: str, code: int | None = 0) -> subprocess.CompletedProcess[str]:
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
        responses = sorted(state.response * 1e6 for state in part if state.response > 0.0)
        found["p50_us"].append(quantile(responses, 0.5))
        found["p99_us"].append(quantile(responses, 0.99))
        found["missed"] += part[-1].missed - part[0].missed + part[-1].overruns - part[0].overruns
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
    return subprocess.run([*PYTHON, "-c", code], capture_output=True, check=False).returncode == 0
