"""One node of a launch as the supervisor sees it: a process of its own to start, look after and end."""

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

# our processes': without the working directory, where a ``sim.py`` may be anybody's
PYTHON = (sys.executable, "-P")
# until a node is ready [s]: eight launches at once on two processors take more than 30 s
START_TIMEOUT = 90.0


class Child:
    """One node's process, started again so often (-1: for ever); the launch ends with one that is `required`."""

    patience = START_TIMEOUT  # how long the launcher waits for it to be ready [s]
    # how much longer than on this machine the first answer over a new connection takes [s]
    distance = 0.0

    def __init__(self, setup: Setup, respawns: int, delay: float, required: bool) -> None:
        self.setup = setup
        kind = load(setup.factory)
        self.drives, self.hops = drives(kind), is_hop(kind)  # a driver; a part of the loop
        self.listens = bool(setup.manifest)  # whether it only listens (a logger)
        self.respawns = respawns
        self.delay = delay
        self.required = required
        self.restarts = 0
        self.process: subprocess.Popen[bytes] | None = None
        self._exit: int | None = None
        self._wait_for_processor = ProcessorWait()
        self.again_at: float | None = None
        self.ready_at = time.monotonic()  # when it was ready; before, when it was made [s]
        # how long its device may take to open, from then on, and to close [s]
        self.opening = self.closing = 0.0
        self.to_start = False
        self.ready = False
        self.over = False
        self.unreported = False  # whether it has ended as if it were done, and did not say so

    @property
    def running(self) -> bool:
        """Whether the process exists."""
        return self.process is not None and self.code is None

    @property
    def code(self) -> int | None:
        """Exit code of the process, which a thread takes from the kernel's table; negative for a signal, None while it runs."""
        if self._exit is None and self.process is not None:
            try:
                ended = os.waitid(os.P_PID, self.process.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT)
            except ChildProcessError:
                # whoever started the launcher ignores SIGCHLD, and the kernel keeps no exit code
                self._exit = 0
                return self._exit
            if ended is not None:
                self._exit = ended.si_status if ended.si_code == os.CLD_EXITED else -ended.si_status
                threading.Thread(target=self.process.wait, name="reap", daemon=True).start()
        return self._exit

    @property
    def end(self) -> str:
        """How it ended, in words."""
        code = self.code
        if self.unreported:
            return (
                f"exit code {code} in mid-run, without its own word that it is done: something in"
                " it has called exit()"
            )
        if code is not None and code < 0:
            return signal.Signals(-code).name
        place = held_in(self.setup) if code else ""
        return f"exit code {code}" + (
            f": its last resort: a call let no other thread run for {place}" if place else ""
        )

    @property
    def ended_badly(self) -> bool:
        """Whether it ended otherwise than by itself, cleanly; one that was still being set up may be ended by SIGTERM."""
        asked = () if self.ready else (-signal.SIGTERM, 128 + signal.SIGTERM)
        return self.unreported or self.code not in (None, 0, *asked)

    @property
    def end_patience(self) -> float:
        """How long it has to end, beside what any node has: what its device declares [s]."""
        return self.closing + max(0.0, self.ready_at + self.opening - time.monotonic())

    def _write_setup(self, run_dir: Path) -> Path:
        path = run_dir / f"{self.setup.name}.json"
        path.parent.mkdir(mode=0o700, exist_ok=True, parents=True)
        # a program that somebody started by hand may be waiting for it
        write_whole(path, self.setup)
        return path

    def start(self, run_dir: Path) -> None:
        """Start the process."""
        path = self._write_setup(run_dir)
        # A group of its own, so that Ctrl-C on the terminal reaches the launcher alone, which ends
        # the nodes in order.
        self.process = subprocess.Popen(
            [*PYTHON, "-m", "nodes", str(path), str(os.getpid())],
            stdin=subprocess.DEVNULL,
            stdout=sys.stderr,
            process_group=0,
        )
        self.again_at = self._exit = None
        # another process: its interpreter is being set up again
        self.ready = self.unreported = False

    def state(self, context: Context, timeout: float = 0.25) -> str:
        """Ask for its state."""
        try:
            return str(call(context, self.setup.control, "status", timeout=timeout)["state"])
        except ControlError:
            return "starting"

    def is_done(self, run_dir: Path) -> bool:
        """Whether it has ended and says itself that it was at its end; whatever else ends it, says nothing."""
        status = self.report(run_dir).get("status", {})
        finished = (
            self.process is not None
            and status.get("pid") == self.process.pid
            and status.get("state") == "finished"
        )
        return self.code == 0 and finished

    @property
    def is_frozen(self) -> bool:
        """Whether the kernel holds on to it; one that has only not got its turn to die yet is not."""
        with contextlib.suppress(OSError, AttributeError):
            return state_of(Path(f"/proc/{self.process.pid}")) in "Tt"  # type: ignore[union-attr]
        return False

    def waited(self) -> float:
        """Tell how long it has waited for a processor, because others had it, since it was asked first [s]."""
        return self._wait_for_processor.look(self.process.pid) if self.process is not None else 0.0

    def progress(self) -> int:
        """Tell how much it has written so far, which grows as long as a logger gets on [bytes]."""
        assert self.process is not None  # noqa: S101
        # One that has ended writes nothing more.
        with contextlib.suppress(OSError):
            for line in (
                Path(f"/proc/{self.process.pid}/io").read_text(encoding="ascii").splitlines()
            ):
                if line.startswith("wchar:"):
                    return int(line.split()[1])
        return 0

    def send(self, number: signal.Signals) -> None:
        """Ask it to end."""
        assert self.process is not None  # noqa: S101
        # Its number is its own until it is taken from the kernel's table, which `code` begins.
        for each in (number, signal.SIGCONT):
            if self.running:
                os.kill(self.process.pid, each)

    def release(self) -> None:
        """Let go of what the supervisor held for it."""

    def report(self, run_dir: Path) -> dict[str, Any]:
        """Read what it told at its end."""
        path = run_dir / f"{self.setup.name}.report.json"
        found: dict[str, Any] = msgspec.json.decode(path.read_bytes()) if path.exists() else {}
        return found
