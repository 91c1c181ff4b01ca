"""Real launches for the tests: private runtime directory, waiting by condition, and nothing left behind at the end.

``with running(folder, "floor_drop", "duration:=0") as launch:`` starts ``haptic launch`` and yields it once its driver
ticks; ``launch_json(folder, "floor_drop", "pace:=lockstep")`` runs one to its end. Both assert that no process of the run
outlives it and that its directory is gone.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import msgspec
import zmq

from messages.transport.requests import ControlError, call
from nodes.launcher.runs import RunInfo, alive

DEADLINE = 60.0
"""When a condition that must come about is given up [s]: a bound for a hung test, not a measure of anything."""

HAPTIC = [sys.executable, "-m", "nodes.cli.main"]


def wait_for(condition: Callable[[], Any], what: str, deadline: float = DEADLINE) -> Any:
    """Poll until a condition is true.

    Parameters
    ----------
    condition : callable
        Its first true result is returned.
    what : str
        What is waited for, for the failure.
    deadline : float
        When to give up [s].

    Returns
    -------
    object
        What the condition returned.
    """
    until = time.monotonic() + deadline
    while True:
        found = condition()
        if found:
            return found
        assert time.monotonic() < until, f"{what}: not within {deadline:g} s"
        time.sleep(0.02)


def processes_of(runtime_dir: Path) -> dict[int, str]:
    """List the live processes of all runs below a runtime directory.

    Parameters
    ----------
    runtime_dir : Path
        The directory; nodes and reapers name it on their command line.

    Returns
    -------
    dict of int to str
        Process number to command line.
    """
    found = {}
    for entry in os.listdir("/proc"):
        if entry.isdigit():
            with contextlib.suppress(FileNotFoundError, ProcessLookupError):
                line = Path(f"/proc/{entry}/cmdline").read_bytes()
                if os.fsencode(runtime_dir) in line and alive(int(entry)):
                    found[int(entry)] = line.replace(b"\0", b" ").decode(errors="replace")
    return found


def assert_nothing_left(runtime_dir: Path) -> None:
    """Assert that no process and no file of any run is left.

    Parameters
    ----------
    runtime_dir : Path
        The runtime directory.
    """
    wait_for(lambda: not processes_of(runtime_dir), f"{runtime_dir}: processes end", 10.0)
    wait_for(lambda: not list(runtime_dir.glob("runs/*")), f"{runtime_dir}: files are removed", 10.0)


@contextlib.contextmanager
def private_runtime_dir() -> Iterator[Path]:
    """Make a runtime directory that no other test sees, short enough for socket paths.

    Yields
    ------
    Path
        The directory, mode 0700.
    """
    with tempfile.TemporaryDirectory(prefix="hapt-", dir="/tmp") as path:  # short: socket paths are
        yield Path(path)


class RunningLaunch:
    """One ``haptic launch`` under way.

    Parameters
    ----------
    folder : Path
        Its working directory; ``stdout.txt`` and ``stderr.txt`` are written there.
    runtime_dir : Path
        Its private runtime directory.
    words : tuple of str
        Scenario and assignments.
    environment : mapping of str to str
        Variables beside those of this process.
    stderr : int or None
        Descriptor to use as standard error in place of ``stderr.txt``.

    Attributes
    ----------
    process : subprocess.Popen
        The launcher.
    context : zmq.Context
        For sockets of the test; ended with the launch.
    """

    def __init__(
        self,
        folder: Path,
        runtime_dir: Path,
        words: tuple[str, ...],
        environment: Mapping[str, str],
        stderr: int | None = None,
    ) -> None:
        self.folder = folder
        self.runtime_dir = runtime_dir
        self.environment = {**os.environ, "HAPTIC_RUNTIME_DIR": str(runtime_dir), **environment}
        self.context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._words = words
        with open(folder / "stdout.txt", "wb") as out, open(folder / "stderr.txt", "wb") as err:
            self.process = subprocess.Popen(
                [*HAPTIC, "launch", *words, "--json", "--no-plot"],
                cwd=folder,
                env=self.environment,
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=err if stderr is None else stderr,
                # Its own group, so that a test can send what Ctrl-C on a terminal sends.
                process_group=0,
            )

    @property
    def errors(self) -> str:
        """What launcher and nodes wrote to standard error so far."""
        return (self.folder / "stderr.txt").read_text(encoding="utf-8", errors="replace")

    @property
    def run(self) -> RunInfo:
        """The run's ``run.json``."""
        found = next(iter(self.runtime_dir.glob("runs/*/run.json")))
        return msgspec.json.decode(found.read_bytes(), type=RunInfo)

    @property
    def run_dir(self) -> Path:
        """The run's private directory."""
        return next(iter(self.runtime_dir.glob("runs/*/run.json"))).parent

    def call(self, node: str, op: str, timeout: float = 20.0, **args: object) -> Any:
        """Ask a node, as the command line does.

        Parameters
        ----------
        node, op : str
            Node and operation, e.g. ``coupling`` and ``param.set``.
        timeout : float
            Longest wait [s].
        **args : object
            Arguments of the operation.

        Returns
        -------
        object
            The result; a refusal raises `ControlError`.
        """
        return call(self.context, self.run.nodes[node].control, op, timeout=timeout, **args)

    def ticks(self) -> int:
        """Tell how many ticks the driver has done.

        Returns
        -------
        int
            0 before the first one.
        """
        try:
            return int(self.call("driver", "status", timeout=1.0)["ticks"])
        except (ControlError, StopIteration):
            return 0

    def wait_ticks(self, more: int) -> int:
        """Wait until the driver has done some more ticks.

        Parameters
        ----------
        more : int
            How many.

        Returns
        -------
        int
            Ticks done then.
        """
        goal = self.ticks() + more
        return int(wait_for(lambda: self._ticks_from(goal), f"tick {goal}"))

    def _ticks_from(self, goal: int) -> int:
        assert self.process.poll() is None, f"the launch ended: {self.errors}"
        ticks = self.ticks()
        return ticks if ticks >= goal else 0

    def haptic(self, *words: str, code: int | None = 0) -> subprocess.CompletedProcess[str]:
        """Run another ``haptic`` command beside the launch.

        Parameters
        ----------
        *words : str
            Its arguments.
        code : int or None
            Exit code to assert; None for any.

        Returns
        -------
        subprocess.CompletedProcess
            With its output as text.
        """
        return haptic(self.folder, *words, code=code, environment=self.environment)

    def finish(self, number: int | None = None, code: int | None = 0) -> dict[str, Any]:
        """Wait for the end and collect the figures.

        Parameters
        ----------
        number : int or None
            Signal to send to the launcher first; None waits for its own end.
        code : int or None
            Exit code to assert; None for any.

        Returns
        -------
        dict
            The object of ``--json``.
        """
        if number is not None:
            self.process.send_signal(number)
        found = self.process.wait(timeout=DEADLINE)
        assert code is None or found == code, f"exit code {found}, expected {code}: {self.errors}"
        lines = (self.folder / "stdout.txt").read_text(encoding="utf-8").splitlines()
        figures: dict[str, Any] = json.loads(lines[-1]) if lines else {}
        return figures


def haptic(
    folder: Path, *words: str, code: int | None = 0, environment: Mapping[str, str] | None = None
) -> subprocess.CompletedProcess[str]:
    """Run one ``haptic`` command to its end.

    Parameters
    ----------
    folder : Path
        Its working directory.
    *words : str
        Its arguments.
    code : int or None
        Exit code to assert; None for any.
    environment : mapping of str to str, optional
        All its variables; those of this process when left out.

    Returns
    -------
    subprocess.CompletedProcess
        With its output as text.
    """
    done = subprocess.run(
        [*HAPTIC, *words],
        cwd=folder,
        env=None if environment is None else dict(environment),
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=DEADLINE,
        check=False,
    )
    assert code is None or done.returncode == code, f"exit code {done.returncode}, expected {code}: {done.stderr}"
    return done


@contextlib.contextmanager
def running(
    folder: Path,
    scenario: str,
    *assignments: str,
    environment: Mapping[str, str] | None = None,
    ready: bool = True,
    stderr: int | None = None,
) -> Iterator[RunningLaunch]:
    """Run a launch for the length of a with block.

    Parameters
    ----------
    folder : Path
        Working directory, e.g. pytest's tmp_path.
    scenario : str
        Scenario, or path of a launch file.
    *assignments : str
        ``name:=value``.
    environment : mapping of str to str, optional
        Variables beside those of this process.
    ready : bool
        Whether to wait until the driver ticks.
    stderr : int or None
        Descriptor to use as standard error of the launch.

    Yields
    ------
    RunningLaunch
        The launch. Unless the block has seen to its end, it is interrupted after the block.
    """
    with private_runtime_dir() as runtime_dir:
        launch = RunningLaunch(folder, runtime_dir, (scenario, *assignments), environment or {}, stderr)
        try:
            if ready:
                wait_for(lambda: launch.process.poll() is not None or launch.ticks() > 0, "the first tick")
                assert not launch.process.poll(), f"the launch ended: {launch.errors}"
            yield launch
        finally:
            if launch.process.poll() is None:
                launch.process.send_signal(signal.SIGINT)
                try:
                    launch.process.wait(timeout=DEADLINE)
                except subprocess.TimeoutExpired:
                    launch.process.kill()
                    launch.process.wait()
            launch.context.destroy(linger=0)
        assert_nothing_left(runtime_dir)


def launch_json(
    folder: Path,
    scenario: str,
    *assignments: str,
    code: int = 0,
    environment: Mapping[str, str] | None = None,
) -> dict[str, Any]:
    """Run a launch to its end.

    Parameters
    ----------
    folder : Path
        Working directory, e.g. pytest's tmp_path.
    scenario : str
        Scenario, or path of a launch file.
    *assignments : str
        ``name:=value``.
    code : int
        Exit code to assert.
    environment : mapping of str to str, optional
        Variables beside those of this process.

    Returns
    -------
    dict
        The object of ``--json``; ``recording`` is relative to `folder`.
    """
    with running(folder, scenario, *assignments, environment=environment, ready=False) as launch:
        return launch.finish(code=code)
