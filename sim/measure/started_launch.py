"""A ``haptic launch`` started by this program: start, first tick, end and answers."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self

from messages.errors import HapticError
from nodes.base.log_line import COMMAND, VARIABLE, LogLine, read_lines
from nodes.client.launches import ask
from nodes.launcher.runs import RunInfo, runs
from sim.measure.haptic_commands import DEADLINE, MeasurementError, end, start_command


class StartedLaunch:
    """A launcher in the background; the end of a ``with`` block ends it as Ctrl-C does.

    Parameters
    ----------
    *words : str
        What stands behind ``haptic launch``: a scenario, its arguments, options.
    folder : Path, optional
        Working directory of the launch, and where its output is kept; without one the launch works
        here, and the output stands in a folder of its own, removed with it.
    environment : mapping of str to str, optional
        Its variables.
    stderr : file or int, optional
        Where else its errors go.

    Attributes
    ----------
    process : subprocess.Popen
        The launcher, in a process group of its own, so that it can be sent what Ctrl-C on a
        terminal sends.
    output : Path
        Folder of ``stdout.txt`` and ``stderr.txt``.
    """

    def __init__(
        self,
        *words: str,
        folder: Path | None = None,
        environment: Mapping[str, str] | None = None,
        stderr: IO[bytes] | int | None = None,
    ) -> None:
        self.words = words
        self._own = Path(tempfile.mkdtemp(prefix="haptic-")) if folder is None else None
        self.output = folder or self._own or Path()
        with (
            open(self.output / "stdout.txt", "wb") as out,
            open(self.output / "stderr.txt", "wb") as errors,
        ):
            self.process = start_command(
                "launch",
                *words,
                "--json",
                "--no-plot",
                cwd=folder,
                env={
                    **(os.environ if environment is None else environment),
                    # read here, where nobody else reads it
                    **({VARIABLE: "json"} if stderr is None else {}),
                },
                stdout=out,
                stderr=errors if stderr is None else stderr,
            )

    def __enter__(self) -> Self:
        """Go on with it."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Leave nothing behind."""
        self.close()

    @property
    def ended(self) -> bool:
        """Whether the launcher has ended."""
        return self.process.poll() is not None

    @property
    def exit_code(self) -> int | None:
        """Exit code of the launcher; None while it runs."""
        return self.process.poll()

    @property
    def lines(self) -> list[str]:
        """Lines that it wrote to standard output so far."""
        return (self.output / "stdout.txt").read_text(encoding="utf-8").splitlines()

    @property
    def figures(self) -> dict[str, Any]:
        """The object of ``--json``; empty before the end, but for the URL of a page."""
        lines = self.lines
        found: dict[str, Any] = json.loads(lines[-1]) if lines else {}
        return found

    @property
    def log(self) -> list[LogLine]:
        """Lines that launcher and nodes wrote to standard error so far."""
        written = (self.output / "stderr.txt").read_text(
            encoding="utf-8", errors="replace"
        )
        return read_lines(written)

    @property
    def errors(self) -> str:
        """The same as text."""
        return "\n".join(map(str, self.log))

    def info(self) -> RunInfo | None:
        """Find the run; None until its launcher has written it down."""
        return next(
            (run for run in runs().values() if run.launcher == self.process.pid), None
        )

    def ticks(self) -> int:
        """Count the ticks of its drivers, of several the slowest; 0 before the first one."""
        info = self.info()
        if info is None:
            return 0
        with contextlib.suppress(HapticError):
            drivers = info.drivers()
            counts = [
                int(ask(info, name, "status", timeout=1.0)["ticks"]) for name in drivers
            ]
            return min(counts, default=0)
        return 0

    def await_tick(
        self,
        number: int = 1,
        longest: float = DEADLINE,
        interrupts: Sequence[object] = (),
    ) -> bool:
        """Wait until its drivers have done some ticks; False where it ended before that was seen.

        Parameters
        ----------
        number : int
            How many ticks.
        longest : float
            Longest wait [s].
        interrupts : sequence
            Of `sim.measure.interrupts.deferred`: a signal that came ends the wait.

        Raises
        ------
        MeasurementError
            When it does not tick in time, or ended with a failure; the text holds what it wrote.
        """
        until = time.monotonic() + longest
        while time.monotonic() < until:
            if interrupts:
                raise KeyboardInterrupt
            # Asked in this order: what has ended by then may have ticked.
            ended = self.ended
            if self.ticks() >= number:
                return True
            if ended:
                if self.exit_code:
                    raise MeasurementError(self.failure())
                # In lockstep a short one is over before anybody looks.
                return False
            time.sleep(0.01)
        raise MeasurementError(
            f"haptic launch: the first tick not within {longest:g} s: {self.errors[-2000:].strip()}"
        )

    def failure(self) -> str:
        """Describe a failed launch: its refusal, or its exit code and output."""
        if self.exit_code == 2:
            # A refusal is the command's own line, without its name.
            log = self.log
            own = [line.text for line in log if line.node == COMMAND]
            return "\n".join(own or map(str, log))[-2000:]
        said = self.errors.strip()[-2000:]
        return (
            f"haptic launch {' '.join(self.words)}: exit code {self.exit_code}: {said}"
        )

    def wait(self, timeout: float | None = None) -> int | None:
        """Wait for its end, at most so long [s]; its exit code, None while it runs."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            return self.process.wait(timeout)
        return None

    def interrupt(self, patience: float = DEADLINE) -> None:
        """End it as Ctrl-C does, if it still goes on, and kill it if that takes too long [s]."""
        end(self.process, patience)

    def close(self) -> None:
        """End it, and remove its own folder."""
        try:
            self.interrupt()
        finally:
            if self._own is not None:
                shutil.rmtree(self._own, ignore_errors=True)
