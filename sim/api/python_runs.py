"""A running launch in Python: change it, record, wait, read its results."""

import contextlib
import json
import shutil
import time
import warnings
import weakref
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from messages.errors import HapticError
from nodes.client import launches
from nodes.launcher.runs import RunInfo, alive
from sim.api.controls import Laws, Parameters
from sim.api.live_data import Live
from sim.api.progress import progress
from sim.api.python_words import speaking_python
from sim.api.recordings import Recorded, read
from sim.api.run_summary import LaunchWarning, RunSummary, summary_of, warnings_in
from sim.measure.haptic_commands import MeasurementError, haptic, run_beside
from sim.measure.interrupts import deferred
from sim.measure.started_launch import StartedLaunch


class LaunchError(HapticError):
    """A launch did not start, or did not end as asked; the text contains its output."""


class Run(Live):
    """A running launch, started or connected to by this program.

    Parameters
    ----------
    info : RunInfo
        Its nodes.
    started : StartedLaunch, optional
        The launch, if this program started it; the end of a ``with`` block stops it.

    Attributes
    ----------
    info : RunInfo
        Its nodes.
    param : Parameters
        Reads and changes parameters.
    law : Laws
        Lists and switches laws.

    Examples
    --------
    >>> with haptic.launch("wall_press", duration=0) as run:
    ...     run.param["coupling.laws.pd.stiffness"] = 800
    ...     run.law.active
    'pd'
    """

    def __init__(self, info: RunInfo, started: StartedLaunch | None = None) -> None:
        self.info = info
        self.param = Parameters(self.ask, self.nodes)
        self.law = Laws(lambda op, **args: self.ask(self.role("coupling"), op, **args))
        self._started = started
        if started is not None:
            weakref.finalize(self, shutil.rmtree, started.output, ignore_errors=True)
        self._summary: RunSummary | None = None
        self._ended_here = False
        self._warned = 0  # number of warnings already issued
        self._warn(4)

    def __enter__(self) -> Self:
        """Return the launch itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Stop the launch if this program started it; otherwise leave it running."""
        if self._started is not None:
            # A warning that is an error does not replace what ended the block.
            lost = (
                contextlib.suppress(LaunchWarning)
                if value
                else contextlib.nullcontext()
            )
            with lost:
                self._end()

    def __repr__(self) -> str:
        state = "running" if self.running else "ended"
        nodes = ", ".join(self.info.nodes)
        return f"<{self.info.run}: {self.info.scenario}, {state}, nodes {nodes}>"

    @property
    def nodes(self) -> list[str]:
        """Names of the nodes."""
        return list(self.info.nodes)

    @property
    def running(self) -> bool:
        """Whether the launch is running."""
        if self._started is not None:
            return not self._started.ended
        return alive(self.info.launcher, self.info.launcher_started)

    def role(self, part: str) -> str:
        """Return the name of the node with a part in the loop.

        Parameters
        ----------
        part : {"driver", "environment", "coupling"}
            Part in the loop.

        Returns
        -------
        str
            Name of the node.
        """
        with speaking_python():
            found = launches.roles(self.info)
        if part not in found:
            raise LaunchError(
                f"{self.info.run}: no node is its {part}; it has {', '.join(self.info.nodes)}"
            )
        return found[part]

    def ask(self, node: str, op: str, **args: Any) -> Any:
        """Send a request to a node; see messages/PROTOCOL.md.

        Parameters
        ----------
        node : str
            Name of the node.
        op : str
            E.g. ``status``.
        **args : object
            Arguments of the request.

        Returns
        -------
        object
            The answer.
        """
        with deferred(), speaking_python():
            return launches.ask(self.info, node, op, **args)

    @property
    def url(self) -> str:
        """URL of the page of a launch with ``view=True``."""
        lines = [] if self._started is None else self._started.lines
        if not lines or "url" not in (printed := json.loads(lines[0])):
            raise LaunchError(f"{self.info.run}: no page; launch with view=True")
        return str(printed["url"])

    @property
    def ticks(self) -> int:
        """Number of ticks that the driver has done."""
        return int(self.ask(self.role("driver"), "status")["ticks"])

    def record(self, duration: float, out: str | Path | None = None) -> Recorded:
        """Record with an additional logger for `duration` seconds.

        Parameters
        ----------
        duration : float
            Length of the recording [s].
        out : str or Path, optional
            File to create, which must not exist; by default a name with the time, beside the
            launch's own recording.

        Returns
        -------
        Recorded
            The recording.

        Raises
        ------
        nodes.launcher.runs.RunError
            If the launch has several chains; ``haptic.connect("SCENARIO/CHAIN")`` records one.
        """
        with speaking_python():
            self.info.only_chain()
        path = (
            Path(out)
            if out is not None
            else self._recordings() / f"recording-{time.strftime('%Y%m%dT%H%M%S')}.mcap"
        )
        words = [
            "--run",
            self.info.chosen,
            "--duration",
            str(duration),
            "--out",
            str(path),
        ]
        try:
            run_beside("bag", "record", *words, "--json")
        except MeasurementError as error:
            raise LaunchError(str(error)) from error
        return read(path)

    def _recordings(self) -> Path:
        """Return the folder of the launch's own recording; without one, the working directory."""
        for name, setup in self.info.nodes.items():
            if setup.kind == "logger" and not setup.control.startswith("tcp://"):
                return Path(self.ask(name, "report")["recording"]).parent
        return Path()

    def wait(self, timeout: float | None = None) -> RunSummary:
        """Wait until the launch ends; interrupting the cell stops the launch.

        Parameters
        ----------
        timeout : float, optional
            Longest wait [s].

        Returns
        -------
        RunSummary
            Its final report.

        Raises
        ------
        LaunchError
            If the launch failed or is still running after `timeout`.
        """
        started = self._started_here("wait for")
        until = None if timeout is None else time.monotonic() + timeout
        # With several chains, progress shows the first.
        driver = next(iter(self.info.drivers()), None)
        total = self.info.nodes[driver].ticks if driver else None
        try:
            with deferred() as came, progress(self.info.scenario, total) as step:
                while not started.ended and not came:
                    if until is not None and time.monotonic() > until:
                        raise LaunchError(
                            f"{self.info.run}: still running after {timeout:g} s"
                        )
                    if driver:
                        with contextlib.suppress(HapticError):
                            step(int(self.ask(driver, "status", timeout=1.0)["ticks"]))
                    started.wait(0.1)
        except KeyboardInterrupt:
            # Nor does a warning that is an error replace the interrupt.
            with contextlib.suppress(LaunchWarning):
                self._end()
            raise
        self._warn()
        return self.summary

    def _warn(self, level: int = 3) -> None:
        """Issue the launch's new warnings as LaunchWarning, `level` frames up the stack."""
        if self._started is None:
            return
        found = warnings_in(self._started.log)
        fresh, self._warned = found[self._warned :], len(found)
        for one in fresh:
            warnings.warn(one, stacklevel=level)

    def rearm(self, driver: str = "") -> dict[str, Any]:
        """Enable forces again after the driver has stopped the loop; return the receipt.

        Parameters
        ----------
        driver : str
            Name of the driver; by default that of the only chain.

        Returns
        -------
        dict
            The tick from which forces ramp up, as ``seq``, and more.

        Raises
        ------
        HapticError
            If there are several drivers and none is named.
        """
        receipt: dict[str, Any] = self.ask(
            driver or self.role("driver"), "rearm", beside=True
        )
        return receipt

    def stop(self) -> None:
        """Stop the launch as Ctrl-C does: ramp the force to zero first, finish the recordings."""
        self._end()

    def _end(self) -> None:
        """Stop the launch, with warnings at the line that called the caller."""
        if self._started is not None:
            self._ended_here = self._ended_here or not self._started.ended
            self._started.interrupt()
            self._warn(4)
            return
        try:
            haptic(Path.cwd(), "stop", self.info.run)
        except MeasurementError as error:
            raise LaunchError(str(error)) from error

    def _started_here(self, what: str) -> StartedLaunch:
        if self._started is None:
            raise LaunchError(
                f"{self.info.run}: started elsewhere; only its own launcher can {what} its end"
            )
        return self._started

    @property
    def summary(self) -> RunSummary:
        """Final report of the launch.

        Raises
        ------
        LaunchError
            If the launch is still running, failed, or was started elsewhere.
        """
        started = self._started_here("report")
        if self._summary is None:
            if not started.ended:
                raise LaunchError(
                    f"{self.info.run}: still running; wait() or stop() first"
                )
            printed = started.figures
            # A killed launch may have printed only the URL of its page.
            if started.exit_code == 1 or "exit_reason" not in printed:
                raise LaunchError(started.failure())
            self._summary = summary_of(printed, started.log, self._ended_here)
        return self._summary

    @property
    def recording(self) -> Recorded:
        """Recording of the launch, after its end.

        Raises
        ------
        LaunchError
            If the launch made no recording on this machine.
        """
        path = self.summary.recording
        if path is None or not Path(path).exists():
            raise LaunchError(f"{self.info.run}: no recording on this machine ({path})")
        return read(path)
