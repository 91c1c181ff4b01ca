"""Launches as measurements: a scenario started as a user starts it, in a folder of its own, answered as figures."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import tempfile
import time
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import msgspec
import zmq

from messages.errors import HapticError
from messages.transport.requests import ControlError, call
from nodes.launcher.child import PYTHON
from nodes.launcher.runs import RunInfo
from sim.measure import stopwatch

HAPTIC = (*PYTHON, "-m", "nodes.cli.main")
"""The command ``haptic`` with this interpreter."""

START = 30.0
"""Longest time from the command to a tick [s]."""


class MeasurementError(HapticError):
    """A launch or a yardstick that was to be measured failed; the text holds what it said."""


def last_line(command: list[str], folder: Path, timeout: float) -> dict[str, Any]:
    """Run a command that answers with one JSON object on its last line."""
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=timeout, check=False)
    try:
        figures: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    except (IndexError, json.JSONDecodeError) as error:
        raise MeasurementError(f"{' '.join(command)}: exit code {done.returncode}\n{done.stderr[-2000:]}") from error
    if done.returncode != 0:
        raise MeasurementError(f"{' '.join(command)}: exit code {done.returncode}\n{done.stderr[-2000:]}")
    return figures


def launch(scenario: str, *words: str, folder: Path | None = None, timeout: float = 300.0) -> dict[str, Any]:
    """Run a scenario to its end."""
    with contextlib.ExitStack() as held:
        if folder is None:
            folder = Path(held.enter_context(tempfile.TemporaryDirectory(prefix="haptic-bench-")))
        return last_line([*HAPTIC, "launch", scenario, "--json", "--no-plot", *words], folder, timeout)


class Running:
    """A launch in the background, in a folder of its own; end it with `end`.

    Parameters
    ----------
    *words : str
        Arguments of ``haptic launch``.

    Attributes
    ----------
    folder : Path
        Working directory; removed at the end of the ``with`` block.
    environment : dict of str to str
        Variables that lead another ``haptic`` command to this launch.
    """

    def __init__(self, *words: str) -> None:
        self._words = words

    def __enter__(self) -> Self:
        """Start it and wait for its first tick."""
        # Short, because the paths of sockets are.
        self._place = tempfile.TemporaryDirectory(prefix="hapb-", dir="/tmp")
        self.folder = Path(self._place.name)
        self.environment = {**os.environ, "HAPTIC_RUNTIME_DIR": str(self.folder / "run")}
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        with open(self.folder / "errors.txt", "wb") as errors:
            self._launcher = subprocess.Popen(
                [*HAPTIC, "launch", *self._words, "--json", "--no-plot"],
                cwd=self.folder,
                env=self.environment,
                stdout=subprocess.PIPE,
                stderr=errors,
            )
        try:
            self.await_tick(1)
        except BaseException:
            self._close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Leave nothing behind."""
        self._close()

    def _close(self) -> None:
        self._context.destroy(linger=0)
        with contextlib.suppress(ProcessLookupError):
            self._launcher.kill()
        self._launcher.wait()
        if self._launcher.stdout is not None:
            self._launcher.stdout.close()
        self._place.cleanup()

    def ask(self, node: str, op: str, **args: Any) -> Any:
        """Ask a node."""
        found = next(iter((self.folder / "run").glob("runs/*/run.json")))
        info = msgspec.json.decode(found.read_bytes(), type=RunInfo)
        return call(self._context, info.nodes[node].control, op, timeout=10.0, **args)

    def await_tick(self, tick: int) -> None:
        """Wait until the driver has come to a tick."""
        deadline = time.monotonic() + START
        while time.monotonic() < deadline and self._launcher.poll() is None:
            with contextlib.suppress(StopIteration, ControlError):
                if self.ask("driver", "status")["ticks"] >= tick:
                    return
            time.sleep(0.05)
        said = (self.folder / "errors.txt").read_text(encoding="utf-8", errors="replace")
        raise MeasurementError(f"the launch did not come to tick {tick} within {START:g} s: {said[-2000:]}")

    def end(self) -> dict[str, Any]:
        """End the launch as Ctrl-C does."""
        self._launcher.send_signal(signal.SIGINT)
        out, _ = self._launcher.communicate(timeout=60.0)
        figures: dict[str, Any] = json.loads(out.splitlines()[-1])
        return figures


def machine() -> str:
    """Name the machine that a figure was measured on."""
    here = stopwatch.machine()
    cores = len(os.sched_getaffinity(0))
    return f"{here['cpu']}, {cores} cores, {here['system']}, Python {here['python']}"


def fifo_granted() -> bool:
    """Whether this user may have real-time priority."""
    code = "import os; os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(50))"
    return subprocess.run([*PYTHON, "-c", code], capture_output=True, check=False).returncode == 0
