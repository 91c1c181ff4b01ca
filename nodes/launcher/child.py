"""A node's process: start it, watch it and end it for the supervisor."""

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import msgspec

from messages.transport.endpoints import Context
from messages.transport.requests import ControlError, call
from nodes.base.hang_watchdog import held_in
from nodes.base.node_kinds import drives, is_hop, load
from nodes.base.processor_wait import ProcessorWait, state_of
from nodes.base.setup import Setup
from nodes.base.status_report import write_whole

# Without the working directory on the path, where any ``sim.py`` may lie.
PYTHON = (sys.executable, "-P")
# Time limit until a node is ready; eight launches at once on two processors take over 30 s [s].
START_TIMEOUT = 90.0


class Child:
    """Process of a node, respawned up to `respawns` times (-1: always).

    The launch ends when a `required` node does.
    """

    patience = START_TIMEOUT  # time limit until it is ready [s]
    # Extra time, compared to this machine, of the first answer over a new connection [s].
    distance = 0.0

    def __init__(
        self, setup: Setup, respawns: int, delay: float, required: bool
    ) -> None:
        self.setup = setup
        kind = load(setup.factory)
        self.drives, self.hops = (
            drives(kind),
            is_hop(kind),
        )  # a driver; a part of the loop
        self.listens = bool(setup.manifest)  # whether it only subscribes (a logger)
        self.respawns = respawns
        self.delay = delay
        self.required = required
        self.restarts = 0
        self.process: subprocess.Popen[bytes] | None = None
        self._exit: int | None = None
        self._wait_for_processor = ProcessorWait()
        self.again_at: float | None = None
        # time when it became ready; before, of creation [s]
        self.ready_at = time.monotonic()
        # Times that its device may take to open, from `ready_at` on, and to close [s].
        self.opening = self.closing = 0.0
        self.to_start = False
        self.ready = False
        self.over = False
        # whether it exited with 0 without reporting that it finished
        self.unreported = False

    @property
    def running(self) -> bool:
        """Whether the process exists."""
        return self.process is not None and self.code is None

    @property
    def code(self) -> int | None:
        """Exit code of the process; negative for a signal, None while it runs.

        A thread then reaps the process.
        """
        if self._exit is None and self.process is not None:
            try:
                ended = os.waitid(
                    os.P_PID, self.process.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT
                )
            except ChildProcessError:
                # The launcher's parent ignores SIGCHLD, so the kernel stores no exit code.
                self._exit = 0
                return self._exit
            if ended is not None:
                self._exit = (
                    ended.si_status
                    if ended.si_code == os.CLD_EXITED
                    else -ended.si_status
                )
                threading.Thread(
                    target=self.process.wait, name="reap", daemon=True
                ).start()
        return self._exit

    @property
    def end(self) -> str:
        """Return how the process ended, as text."""
        code = self.code
        if self.unreported:
            return (
                f"exit code {code} in mid-run without reporting that it finished: something in it"
                " called exit()"
            )
        if code is not None and code < 0:
            return signal.Signals(-code).name
        place = held_in(self.setup) if code else ""
        return f"exit code {code}" + (
            f": its last resort: a call blocked all other threads for {place}"
            if place
            else ""
        )

    @property
    def ended_badly(self) -> bool:
        """Whether it ended abnormally; SIGTERM during set-up counts as normal."""
        asked = () if self.ready else (-signal.SIGTERM, 128 + signal.SIGTERM)
        return self.unreported or self.code not in (None, 0, *asked)

    @property
    def end_patience(self) -> float:
        """Return the extra time it has to end, from what its device declares [s]."""
        return self.closing + max(0.0, self.ready_at + self.opening - time.monotonic())

    def _write_setup(self, run_dir: Path) -> Path:
        path = run_dir / f"{self.setup.name}.json"
        path.parent.mkdir(mode=0o700, exist_ok=True, parents=True)
        # A manually started program may be waiting for the file.
        write_whole(path, self.setup)
        return path

    def start(self, run_dir: Path) -> None:
        """Start the process."""
        path = self._write_setup(run_dir)
        # In its own process group, so that Ctrl-C reaches only the launcher, which ends the nodes
        # in order.
        self.process = subprocess.Popen(
            [*PYTHON, "-m", "nodes", str(path), str(os.getpid())],
            stdin=subprocess.DEVNULL,
            stdout=sys.stderr,
            process_group=0,
        )
        self.again_at = self._exit = None
        # A new process has to be set up again.
        self.ready = self.unreported = False

    def state(self, context: Context, timeout: float = 0.25) -> str:
        """Ask the node for its state; ``"starting"`` without an answer."""
        try:
            return str(
                call(context, self.setup.control, "status", timeout=timeout)["state"]
            )
        except ControlError:
            return "starting"

    def is_done(self, run_dir: Path) -> bool:
        """Whether it exited with code 0 and reported that it had finished."""
        status = self.report(run_dir).get("status", {})
        finished = (
            self.process is not None
            and status.get("pid") == self.process.pid
            and status.get("state") == "finished"
        )
        return self.code == 0 and finished

    @property
    def is_frozen(self) -> bool:
        """Whether the kernel has stopped the process (SIGSTOP or a debugger)."""
        with contextlib.suppress(OSError, AttributeError):
            return state_of(Path(f"/proc/{self.process.pid}")) in "Tt"  # type: ignore[union-attr]
        return False

    def waited(self) -> float:
        """Return how long it has waited for a processor since the first call [s]."""
        return (
            self._wait_for_processor.update(self.process.pid)
            if self.process is not None
            else 0.0
        )

    def progress(self) -> int:
        """Return the bytes it has written so far, which grow while a logger works."""
        assert self.process is not None  # noqa: S101
        # The process may have ended.
        with contextlib.suppress(OSError):
            for line in (
                Path(f"/proc/{self.process.pid}/io")
                .read_text(encoding="ascii")
                .splitlines()
            ):
                if line.startswith("wchar:"):
                    return int(line.split()[1])
        return 0

    def send(self, number: signal.Signals) -> None:
        """Send a signal, and wake the process if it is stopped."""
        assert self.process is not None  # noqa: S101
        # The process number stays valid until `code` reaps the process.
        for each in (number, signal.SIGCONT):
            if self.running:
                os.kill(self.process.pid, each)

    def release(self) -> None:
        """Release the supervisor's resources for it."""

    def report(self, run_dir: Path) -> dict[str, Any]:
        """Read the node's final report."""
        path = run_dir / f"{self.setup.name}.report.json"
        found: dict[str, Any] = (
            msgspec.json.decode(path.read_bytes()) if path.exists() else {}
        )
        return found
