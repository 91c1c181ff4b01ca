"""A launch under fault injection.

The rig subscribes like any other subscriber and acts with signals and control requests; nothing in
the launch knows that it is a drill.
"""

import contextlib
import os
import signal
import subprocess
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

import msgspec

from messages.codec import Decoder, MessageRefusedError
from messages.topics import DEVICE_STATE
from messages.transport.sockets import Subscription
from messages.types import DeviceState
from nodes.base.processor_wait import ProcessorWait, state_of
from sim.measure.haptic_commands import DEADLINE, HAPTIC, wait_for, within
from sim.measure.measured_launch import Running, left_behind, processes_of

START = 30.0  # time limit from the first tick to the first messages [s]
# Time limit from the interrupt to the end, without time spent waiting for a processor [s].
END = 20.0


def full_pipe() -> tuple[int, int]:
    """Create a pipe that is full and never read, so that its writer blocks."""
    reading, writing = os.pipe()
    # Open it once more, to fill the pipe without making the writer's end non-blocking.
    filling = os.open(f"/proc/self/fd/{writing}", os.O_WRONLY | os.O_NONBLOCK)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(filling, bytes(4096))
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(filling, b"\0")
    os.close(filling)
    return reading, writing


class Rig(Running):
    """A launch under fault injection; with `unread`, nobody reads its standard error."""

    def __init__(
        self,
        content: Mapping[str, Any],
        environment: Mapping[str, str] | None = None,
        unread: bool = False,
    ) -> None:
        self._pipe = full_pipe() if unread else ()
        # A process that hangs prints its stack on SIGABRT.
        environment = {"PYTHONFAULTHANDLER": "1", **(environment or {})}
        super().__init__(
            "drill.yaml",
            environment=environment,
            stderr=self._pipe[1] if self._pipe else None,
        )
        # JSON is YAML
        (self.folder / "drill.yaml").write_bytes(msgspec.json.encode(content))
        self.states: list[DeviceState] = []  # states published, in the order of receipt
        # Result of ``haptic launch --json``; empty before the end.
        self.summary: dict[str, Any] = {}
        self.left: list[str] = []  # processes and files that outlived the launch
        self.said = ""  # complete standard error
        self._ending = threading.Event()
        self._listener: threading.Thread | None = None

    def __enter__(self) -> Self:
        """Wait for the first ticks, and subscribe."""
        super().__enter__()
        try:
            inbox = Subscription(
                self.context,
                [self.run.publishers()["driver"]],
                [DEVICE_STATE],
                queue=100_000,
            )
            self._listener = threading.Thread(
                target=self._listen, args=(inbox,), daemon=True
            )
            self._listener.start()
            wait_for(lambda: len(self.states) > 50, "what the driver publishes", START)
        except BaseException:
            self.close()
            raise
        return self

    def _listen(self, inbox: Subscription) -> None:
        decoder = Decoder(DeviceState)
        while not self._ending.is_set():
            frames = inbox.receive(50)
            if frames is not None:
                with contextlib.suppress(MessageRefusedError):
                    self.states.append(decoder.decode(frames[1]))
        inbox.close()

    def kill(self, node: str, number: signal.Signals = signal.SIGKILL) -> int:
        """Send a signal to a node; return its process number."""
        pid = self.pid(node)
        os.kill(pid, number)
        return pid

    def let_pass(self, seconds: float) -> None:
        """Wait for some time, or until the launch ends."""
        within(lambda: self.process.poll() is not None, seconds)

    def beside(self, *words: str) -> subprocess.Popen[bytes]:
        """Start another ``haptic`` command; its output goes to `beside.txt` in the folder."""
        with (self.folder / "beside.txt").open("ab") as said:
            return subprocess.Popen(
                [*HAPTIC, *words],
                cwd=self.folder,
                env=self.environment,
                stdin=subprocess.DEVNULL,
                stdout=said,
                stderr=said,
            )

    def end(self) -> None:
        """Interrupt the launch, wait for its end, and list what it left; the folder stays."""
        if self._ending.is_set():
            return
        self._ending.set()
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        self._await_end()
        self.said = self.errors
        self.left = left_behind(self.runtime_dir, 5.0)
        if self.process.poll() is None:
            self.left.append(
                f"process {self.process.pid}: the launcher; {self._whereabouts()}"
            )
        self.interrupt(0.0)
        self.summary = self.figures
        if self._listener is not None:
            self._listener.join()

    def _await_end(self) -> None:
        """Wait for the launcher's end, extended by the time its processes wait for a processor."""
        waits: dict[int, ProcessorWait] = {}
        begun = time.monotonic()
        waited = 0.0
        while self.process.poll() is None and time.monotonic() - begun < self._patience(
            waited
        ):
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.process.wait(0.5)
                return
            for pid in (self.process.pid, *processes_of(self.runtime_dir)):
                waited = max(waited, waits.setdefault(pid, ProcessorWait()).update(pid))

    def _patience(self, waited: float) -> float:
        """Return how long the launcher may take to end [s]."""
        # Its main thread has ended; the others do so once they have a processor.
        is_ending = state_of(Path(f"/proc/{self.process.pid}")) == "Z"
        return DEADLINE if is_ending else END + waited

    def _whereabouts(self) -> str:
        """Return where a launcher hangs: its threads' kernel waits and Python stack."""
        threads = []
        state = state_of(Path(f"/proc/{self.process.pid}"))
        for path in Path(f"/proc/{self.process.pid}/task").iterdir():
            with contextlib.suppress(OSError):
                threads.append(
                    " ".join(
                        (path / name).read_text().strip()
                        for name in ("comm", "wchan", "syscall")
                    )
                )
        self.process.send_signal(signal.SIGABRT)
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.process.wait(2.0)
        return "\n".join([f"state {state}", *threads, self.errors[len(self.said) :]])

    def close(self) -> None:
        """End the launch and remove its folder."""
        try:
            self.end()
        finally:
            super().close()
            for descriptor in self._pipe:
                os.close(descriptor)
            self._pipe = ()
