"""A node started by hand: on another machine, under a debugger, or in another language.

The launcher waits for it at its control endpoint, sends its setup, measures its clock offset
repeatedly, considers it lost if it stays silent, and asks it to stop at the end. No signal can
reach it, so it has a lease that every request of the launcher renews, and stops when the lease
expires. Restarting a lost one counts as a respawn: the launch file decides whether it is accepted.
"""

import contextlib
import math
import shlex
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec

from messages.transport.endpoints import Context, split
from messages.transport.requests import Connection, ControlError, NoAnswerError
from nodes.base.node_kinds import load
from nodes.base.setup import Setup
from nodes.launcher.child import Child
from nodes.parameters.paths import needed
from nodes.parameters.store import convert

# The time limits below are extended by `ByHand.distance`.
ARRIVAL_TIMEOUT = 120.0  # time that the launcher waits for a manual start [s]
LOST = 5.0  # time without an answer after which a node counts as lost [s]
# time after which a finished node counts as gone, with or without report [s]
UNREPORTED = 2.0
LEASE = 6.0  # time without a request after which such a node stops [s]

ROUND_TRIPS = 12
"""Round trips that the first answer over a new connection may take.

One for tcp, two for the greeting, two for the keys, one for the request, and as many again if the
first attempt found nobody or lost a packet.
"""

# First and largest timeout of a request [s].
ANSWER, LONGEST_ANSWER = 1.0, 8.0
# Drift between two monotonic clocks: two ordinary crystals of 25 ppm each [s/s].
DRIFT = 50e-6
WINDOW = 16  # stored clock measurements

STATUS_PERIOD = 0.5  # time between requests while the node is ready or running [s]
_QUICK = 0.05  # time between requests before that and at the end [s]

_ROUNDS = 8  # clock measurements in a burst, at the start; at most for a second


def command(setup: Setup) -> str:
    """Return the command that starts a node by hand."""
    bare, _ = split(setup.control)
    if bare.startswith("ipc://"):
        own = f"{setup.run_dir}/{setup.name}.json"
        return (
            f"haptic node start {setup.name} --run {setup.run}   (or a program of your own, with"
            f" {own})"
        )
    host, _, port = bare.removeprefix("tcp://").rpartition(":")
    words = ["haptic node start", setup.name, "--bind", f"{host}:{int(port) - 1}"]
    if setup.kind != setup.name:
        words += ["--kind", setup.kind]
    for folder in needed(
        convert(setup.parameters, load(setup.factory).Parameters, setup.name)
    ):
        words += ["--allow-path", shlex.quote(folder)]
    return f"on {host}: {' '.join(words)}"


class ClockOffset:
    """Estimates the offset of another host's monotonic clock from its answers.

    The time of a run is that of the launcher's host. A request sent at t0 and answered at t3 with
    the remote time r shows that the remote clock was at r between t0 and t3. So the offset is (t0 +
    t3)/2 − r, with an error of at most half the round trip. The shortest of the last round trips is
    best (NTP's filter); an old one becomes less certain at the rate at which two crystals may drift
    apart.
    """

    def __init__(self) -> None:
        self._measured: deque[tuple[float, float, float]] = deque(maxlen=WINDOW)

    def add(self, asked: float, remote: float, answered: float) -> None:
        """Add a measurement."""
        if answered >= asked:
            self._measured.append(
                (answered, (asked + answered) / 2.0 - remote, (answered - asked) / 2.0)
            )

    def best(self, now: float) -> tuple[float, float]:
        """Return the best offset and its error bound [s]."""
        if not self._measured:
            return 0.0, float("inf")
        bounds = [
            (half + DRIFT * max(now - when, 0.0), offset)
            for when, offset, half in self._measured
        ]
        error, offset = min(bounds)
        return offset, error


class ByHand(Child):
    """A node that the launcher waits for instead of starting."""

    patience = ARRIVAL_TIMEOUT

    def __init__(
        self,
        setup: Setup,
        respawns: int,
        delay: float,
        required: bool,
        context: Context,
        say: Callable[[str], None],
    ) -> None:
        super().__init__(setup, respawns, delay, required)
        self._line = Connection(context, setup.control)
        self._say = say
        self._far = split(setup.control)[0].startswith("tcp://")
        self._thread: threading.Thread | None = None
        self._ending = threading.Event()
        self._reset()

    def _reset(self) -> None:
        self._clock = ClockOffset()
        self._state = "not started"
        self._seen = 0.0
        self._process = self._received = 0
        self._code: int | None = None
        self._end = ""
        self._over: tuple[int, str] | None = None
        self._stop = False
        self._report: dict[str, Any] = {}
        self._wait = ANSWER

    @property
    def distance(self) -> float:  # type: ignore[override]
        """Return the extra time of a first answer, from the clock measurements [s]."""
        error = self._clock.best(time.monotonic())[1]
        return ROUND_TRIPS * 2.0 * error if math.isfinite(error) else 0.0

    @property
    def end_patience(self) -> float:
        """Return the extra time it has to end: pending request, stop and report [s]."""
        return super().end_patience + self.distance

    @property
    def running(self) -> bool:
        """Whether it runs or is still waited for."""
        return self._code is None and self._thread is not None

    @property
    def code(self) -> int | None:
        """0 after a clean end, 1 after a failure or loss, None while it runs."""
        return self._code

    @property
    def end(self) -> str:
        """Return how it ended, as text."""
        return self._end

    def start(self, run_dir: Path) -> None:
        """Print how to start the node, and wait for it on a thread."""
        self.release()
        self._write_setup(run_dir)
        self._reset()
        self.again_at = None
        self._say(f"waiting for {self.setup.name}: {command(self.setup)}")
        self._ending.clear()
        self._thread = threading.Thread(
            target=self._watch, name=f"{self.setup.name}-watch", daemon=True
        )
        self._thread.start()

    def state(self, context: Context, timeout: float = 0.25) -> str:
        """Return the last known state."""
        del context, timeout
        return self._state

    def is_done(self, run_dir: Path) -> bool:
        """Whether it reported a clean end."""
        del run_dir
        return self._code == 0

    def progress(self) -> int:
        """Return the number of messages it has received, as last reported."""
        return self._received

    def send(self, number: signal.Signals) -> None:
        """Ask it to stop; if it no longer answers, its lease ends it."""
        if number == signal.SIGKILL or not self._seen:
            self._code, self._end = self._over or (1, self._end or "given up")
        self._stop = True

    def release(self) -> None:
        """Stop watching."""
        self._ending.set()
        if self._thread is not None:
            self._thread.join()

    def report(self, run_dir: Path) -> dict[str, Any]:
        """Return its final report."""
        del run_dir
        return self._report

    # -- on the watching thread
    # --------------------------------------------------------------------------------------

    def _ask(self, op: str, **args: object) -> Any:
        wait = self._wait
        if self._seen:
            limit = UNREPORTED + self.distance if self._over else self._lost
            wait = min(wait, max(0.25, limit - (time.monotonic() - self._seen)))
        asked = time.monotonic()
        answer = self._line.call(op, timeout=wait, **args)
        self._seen = time.monotonic()
        self._wait = max(ANSWER, self.distance, self._seen - asked)
        return answer

    @property
    def _lost(self) -> float:
        return LOST + round(self.distance)

    def _watch(self) -> None:
        try:
            self._watch_on()
        finally:
            self._line.drop()

    def _watch_on(self) -> None:
        while not self._ending.is_set() and self._code is None:
            try:
                self._visit()
            except ControlError as error:
                silent = time.monotonic() - self._seen if self._seen else 0.0
                self._wait = min(2.0 * self._wait, LONGEST_ANSWER)
                if self._over and silent > UNREPORTED + self.distance:
                    self._code, self._end = self._over
                elif silent > self._lost:
                    self._code = 1
                    self._end = f"no answer for {self._lost:g} s ({error})"
            except (
                AttributeError,
                KeyError,
                OverflowError,
                TypeError,
                ValueError,
            ) as error:
                # A foreign program may send anything.
                self._code, self._end = (
                    1,
                    f"an answer that violates the protocol ({type(error).__name__}: {error})",
                )
            ready = self._state in ("ready", "running")
            self._ending.wait(STATUS_PERIOD if ready and not self._stop else _QUICK)

    def _visit(self) -> None:
        status = self._ask("status")
        state = str(status["state"])
        process = int(status.get("pid", 0))
        if self._process and process != self._process:
            # Restarted before the loss was noticed: the new process has no setup, and a driver
            # does not know that the run has started.
            self._code = 1
            self._end = f"process {process} in place of {self._process}"
            return
        self._process = process
        self._received = int(status.get("received", 0))
        if state == "unconfigured":
            with self._optional("configure"):
                self._ask("configure", setup=msgspec.to_builtins(self._with_clock()))
            # The node replaces the waiting socket by its own sockets.
            self._line.drop()
            return
        if state in ("ready", "running") and self._state not in ("ready", "running"):
            self._arrive()
        elif self._far:
            self._measure()
        if self._stop and state not in ("finished", "failed"):
            self._ask("stop")
        if state in ("finished", "failed"):
            self._over = (0, "a clean end") if state == "finished" else (1, "a failure")
            with self._optional():
                self._report = {"status": status, **self._ask("report")}
            self._code, self._end = self._over
        self._state = state

    def _with_clock(self) -> Setup:
        """Return the setup with the measured clock offset, so that stamps are right at once."""
        self._measure_well(tell=False)
        offset, error = self._clock.best(time.monotonic())
        if not math.isfinite(error):
            return self.setup
        lease = self.setup.lease + round(self.distance)
        return msgspec.structs.replace(
            self.setup, clock_offset=offset, clock_error=error, lease=lease
        )

    @contextlib.contextmanager
    def _optional(self, needed: str = "") -> Iterator[None]:
        """Ignore a node's refusal, unless it is `needed`; a lost answer still raises."""
        try:
            yield
        except NoAnswerError:
            raise
        except ControlError as error:
            if needed:
                self._code = 1
                self._end = f"{needed} refused: {error}"

    def _arrive(self) -> None:
        clock = ""
        if self._far:
            self._measure_well()
            offset, error = self._clock.best(time.monotonic())
            clock = f"; its clock is {-offset:+.6f} s from here, known to ±{error * 1e6:.0f} µs"
        self._say(f"{self.setup.name}: connected{clock}")

    def _measure_well(self, tell: bool = True) -> None:
        until = time.monotonic() + 1.0
        for _ in range(_ROUNDS):
            self._measure(tell)
            if time.monotonic() > until:
                break

    def _measure(self, tell: bool = True) -> None:
        """Measure the clock offset and send it; a node may refuse it."""
        asked = time.monotonic()
        with self._optional():
            remote = float(self._ask("clock")["monotonic_s"])
            self._clock.add(asked, remote, time.monotonic())
        if not math.isfinite(self._clock.best(asked)[1]):
            return
        offset, bound = self._clock.best(time.monotonic())
        if tell:
            with self._optional():
                self._ask("clock.set", offset=offset, error=bound)
