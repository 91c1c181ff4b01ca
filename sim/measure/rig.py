"""A real launch to be maltreated: started as a user starts it, watched at its driver's topic, ended, and looked after.

The rig listens as any listener does and strikes from outside, with signals and control requests; nothing in the launch knows
that it is a drill.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import msgspec

from messages.codec import Decoder, MessageRefusedError
from messages.topics import DEVICE_STATE
from messages.transport.requests import ControlError, call
from messages.transport.sockets import Subscription, new_context
from messages.types import DeviceState
from nodes.base.realtime import die_with_parent
from nodes.launcher.runs import RunInfo, alive
from sim.measure.launches import HAPTIC, MeasurementError

START = 30.0
"""Longest time from the command to the first tick [s]."""

END = 20.0
"""Longest time from the interrupt to the end [s]."""


class RigError(MeasurementError):
    """The launch could not be started, or does not answer."""


def full_pipe() -> tuple[int, int]:
    """Make a pipe that nobody reads: whoever writes to it waits."""
    reading, writing = os.pipe()
    # A description of its own: the pipe is filled without making the writer's end non-blocking.
    filling = os.open(f"/proc/self/fd/{writing}", os.O_WRONLY | os.O_NONBLOCK)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(filling, bytes(4096))
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(filling, b"\0")
    os.close(filling)
    return reading, writing


class Rig:
    """One launch under maltreatment.

    Parameters
    ----------
    content : mapping
        The launch file, as builtins.
    environment : mapping of str to str, optional
        Variables beside those of this process.
    unread : bool
        Whether nobody reads what the launch prints to standard error.

    Attributes
    ----------
    folder : Path
        Working directory of the launch; removed at the end.
    runtime : Path
        Its runtime directory.
    states : list of DeviceState
        What the driver published, in the order of receipt.
    figures : dict
        What ``haptic launch --json`` answered; empty before the end.
    exit_code : int or None
        Exit code of the launcher.
    left : list of str
        Processes and files that outlived the launch.
    """

    def __init__(
        self, content: Mapping[str, Any], environment: Mapping[str, str] | None = None, unread: bool = False
    ) -> None:
        # Short, because the paths of sockets are.
        self.folder = Path(tempfile.mkdtemp(prefix="hd-", dir=Path("/tmp")))  # noqa: S108
        self.runtime = self.folder / "run"
        self.runtime.mkdir(mode=0o700)
        launch = self.folder / "drill.yaml"
        launch.write_bytes(msgspec.json.encode(content))  # JSON is YAML
        self.environment = {**os.environ, **(environment or {}), "HAPTIC_RUNTIME_DIR": str(self.runtime)}
        self.states: list[DeviceState] = []
        self.figures: dict[str, Any] = {}
        self.exit_code: int | None = None
        self.left: list[str] = []
        self._context = new_context()
        self._ending = threading.Event()
        self._listener: threading.Thread | None = None
        self._info: RunInfo | None = None
        self._pipe = list(full_pipe()) if unread else []
        with open(self.folder / "out", "wb") as out, open(self.folder / "err", "wb") as err:
            self.launcher = subprocess.Popen(
                [*HAPTIC, "launch", str(launch), "--json", "--no-plot"],
                cwd=self.folder,
                env=self.environment,
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=self._pipe[1] if unread else err,
                process_group=0,
                # A drill that is killed must not leave its launch behind.
                preexec_fn=die_with_parent,
            )

    def __enter__(self) -> Self:
        """Wait for the first ticks, and listen."""
        try:
            if not self.wait(self._started, START):
                raise RigError(f"the launch does not tick: {self.errors}")
            inbox = Subscription(self._context, [self.info.publishers()["driver"]], [DEVICE_STATE], queue=100_000)
            self._listener = threading.Thread(target=self._listen, args=(inbox,), daemon=True)
            self._listener.start()
            if not self.wait(lambda: len(self.states) > 50, START):
                raise RigError(f"the driver does not publish: {self.errors}")
        except BaseException:
            self.end()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the launch, whatever happened."""
        self.end()

    def _started(self) -> bool:
        if self.launcher.poll() is not None:
            raise RigError(f"the launch ended with exit code {self.launcher.returncode}: {self.errors}")
        with contextlib.suppress(RigError, ControlError):
            return bool(self.call("driver", "status", timeout=0.5)["ticks"])
        return False

    def _listen(self, inbox: Subscription) -> None:
        decoder = Decoder(DeviceState)
        while not self._ending.is_set():
            frames = inbox.receive(50)
            if frames is not None:
                with contextlib.suppress(MessageRefusedError):
                    self.states.append(decoder.decode(frames[1]))
        inbox.close()

    @property
    def errors(self) -> str:
        """The last of what launcher and nodes wrote to standard error."""
        return (self.folder / "err").read_text(encoding="utf-8", errors="replace")[-4000:]

    @property
    def info(self) -> RunInfo:
        """What the run consists of."""
        if self._info is None:
            found = list(self.runtime.glob("runs/*/run.json"))
            if not found:
                raise RigError("the run is not there yet")
            self._info = msgspec.json.decode(found[0].read_bytes(), type=RunInfo)
        return self._info

    def wait(self, condition: Callable[[], Any], longest: float) -> bool:
        """Wait for a condition."""
        until = time.monotonic() + longest
        while not condition():
            if time.monotonic() > until:
                return False
            time.sleep(0.01)
        return True

    def call(self, node: str, op: str, timeout: float = 5.0, **args: object) -> Any:
        """Ask a node."""
        return call(self._context, self.info.nodes[node].control, op, timeout=timeout, **args)

    def pid(self, node: str) -> int:
        """Find a node's process."""
        return int(self.call(node, "status")["pid"])

    def kill(self, node: str, number: signal.Signals = signal.SIGKILL) -> int:
        """Send a signal to a node."""
        pid = self.pid(node)
        os.kill(pid, number)
        return pid

    def beside(self, *words: str) -> subprocess.Popen[bytes]:
        """Start another ``haptic`` command beside the launch, in its folder."""
        return subprocess.Popen(
            [*HAPTIC, *words],
            cwd=self.folder,
            env=self.environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )

    def processes(self) -> list[str]:
        """List the live processes of the run, its guard included."""
        found = []
        for entry in os.listdir("/proc"):
            with contextlib.suppress(FileNotFoundError, ProcessLookupError, ValueError):
                line = Path(f"/proc/{int(entry)}/cmdline").read_bytes()
                if os.fsencode(self.runtime) in line and alive(int(entry)):
                    found.append(f"process {entry}: {line.replace(bytes(1), b' ').decode(errors='replace').strip()}")
        return found

    def end(self, look: Callable[[], None] | None = None) -> None:
        """Interrupt the launch, wait for its end, and see what it has left behind."""
        if self._ending.is_set():
            return
        try:
            self._end()
            if look is not None:
                look()
        finally:
            shutil.rmtree(self.folder, ignore_errors=True)

    def _end(self) -> None:
        if self.launcher.poll() is None:
            self.launcher.send_signal(signal.SIGINT)
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.exit_code = self.launcher.wait(END)
        self.wait(lambda: not self.processes(), 5.0)
        self.left = [*self.processes(), *(f"file {path}" for path in (self.runtime / "runs").rglob("*"))]
        if self.launcher.poll() is None:
            self.left.append(f"process {self.launcher.pid}: the launcher")
            self.launcher.kill()
            self.launcher.wait()
        lines = (self.folder / "out").read_text(encoding="utf-8").splitlines()
        if lines:
            self.figures = json.loads(lines[-1])
        self._ending.set()
        if self._listener is not None:
            self._listener.join()
        self._context.term()
        for descriptor in self._pipe:
            os.close(descriptor)
