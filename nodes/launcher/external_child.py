"""A node that somebody else starts: on another machine, under a debugger, or written in another language.

The launcher waits for it on its control endpoint, hands it its setup, keeps measuring how far its
clock is from the launcher's, takes it as lost when it stays silent, and asks it to stop at the end.
What no signal can reach ends by itself: such a node has a lease, which every request of the
launcher renews. One that is started once more in place of a lost one is a respawn like any other:
the launch file says whether it is taken back.
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

PATIENCE = 120.0  # how long the launcher waits for somebody to start a node [s]
# after so long without an answer, and its distance, a node that was there is taken as lost [s]
LOST = 5.0
# after so long, and its distance, a node that said it is finished is believed gone, report or not
# [s]
UNREPORTED = 2.0
# after so long without a request, and its distance, such a node takes its launcher as lost, and
# stops [s]
LEASE = 6.0

ROUND_TRIPS = 12
"""What the first answer over a new connection may take: one for tcp, two for the greeting, two for the keys, one for itself,
and as many again where the first try found nobody there yet, or lost a packet."""

# how long an answer is waited for at first, and at last: the distance may be that long [s]
ANSWER, LONGEST_ANSWER = 1.0, 8.0
# how fast two monotonic clocks may drift apart [s/s]: two ordinary crystals of 25 ppm each
DRIFT = 50e-6
WINDOW = 16  # measurements of a clock that are kept

PERIOD = 0.5
_QUICK = 0.05

_ROUNDS = 8  # how often the clock is measured at once, before and after the start, or for a second


def command(setup: Setup) -> str:
    """Tell how to start a node by hand."""
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
    for folder in needed(convert(setup.parameters, load(setup.factory).Parameters, setup.name)):
        words += ["--allow-path", shlex.quote(folder)]
    return f"on {host}: {' '.join(words)}"


class ClockOffset:
    """Offset of another host's monotonic clock, from repeated questions for its time.

    The time of a run is that of the launcher's host. Of a question asked at t0, answered with the
    other's time r and received at t3, only so much is known: r was the other's time somewhere
    between t0 and t3. So the offset is (t0 + t3)/2 − r, off by at most half the round trip; the
    shortest of the last round trips tells best (NTP's filter), and an old one loses worth at the
    rate at which two crystals may drift apart.
    """

    def __init__(self) -> None:
        self._measured: deque[tuple[float, float, float]] = deque(maxlen=WINDOW)

    def add(self, asked: float, remote: float, answered: float) -> None:
        """Take one measurement."""
        if answered >= asked:
            self._measured.append(
                (answered, (asked + answered) / 2.0 - remote, (answered - asked) / 2.0)
            )

    def best(self, now: float) -> tuple[float, float]:
        """Give the offset that is known best."""
        if not self._measured:
            return 0.0, float("inf")
        bounds = [
            (half + DRIFT * max(now - when, 0.0), offset) for when, offset, half in self._measured
        ]
        error, offset = min(bounds)
        return offset, error


class ByHand(Child):
    """A node that the launcher waits for instead of starting it."""

    patience = PATIENCE

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
        """As its clock's measurements tell it [s]."""
        error = self._clock.best(time.monotonic())[1]
        return ROUND_TRIPS * 2.0 * error if math.isfinite(error) else 0.0

    @property
    def end_patience(self) -> float:
        """How long it has to end: what is being asked of it, that it stops, and its report, each in its turn [s]."""
        return super().end_patience + self.distance

    @property
    def running(self) -> bool:
        """Whether it is there, or still waited for."""
        return self._code is None and self._thread is not None

    @property
    def code(self) -> int | None:
        """0 after a clean end, 1 after a failure or when it was lost, None while it runs."""
        return self._code

    @property
    def end(self) -> str:
        """How it ended, in words."""
        return self._end

    def start(self, run_dir: Path) -> None:
        """Tell how to start it, and wait for it on a thread."""
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
        """Tell its state as last heard."""
        del context, timeout
        return self._state

    def is_done(self, run_dir: Path) -> bool:
        """Whether it says itself that it was at its end."""
        del run_dir
        return self._code == 0

    def progress(self) -> int:
        """Tell how many messages it has taken, as last heard."""
        return self._received

    def send(self, number: signal.Signals) -> None:
        """Ask it to stop; what does not answer any more is left to its lease."""
        if number == signal.SIGKILL or not self._seen:
            self._code, self._end = self._over or (1, self._end or "given up")
        self._stop = True

    def release(self) -> None:
        """Stop watching."""
        self._ending.set()
        if self._thread is not None:
            self._thread.join()

    def report(self, run_dir: Path) -> dict[str, Any]:
        """Give what it told at its end."""
        del run_dir
        return self._report

    # -- on the watching thread
    # --------------------------------------------------------------------------------------

    def _ask(self, op: str, **args: object) -> Any:
        wait = self._wait
        if self._seen:
            patience = UNREPORTED + self.distance if self._over else self._lost
            wait = min(wait, max(0.25, patience - (time.monotonic() - self._seen)))
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
                    self._code, self._end = 1, f"no answer for {self._lost:g} s ({error})"
            except (AttributeError, KeyError, OverflowError, TypeError, ValueError) as error:
                # Of a program of somebody else's anything may come.
                self._code, self._end = (
                    1,
                    f"an answer that is not of the protocol ({type(error).__name__}: {error})",
                )
            ready = self._state in ("ready", "running")
            self._ending.wait(PERIOD if ready and not self._stop else _QUICK)

    def _visit(self) -> None:
        status = self._ask("status")
        state, process = str(status["state"]), int(status.get("pid", 0))
        if self._process and process != self._process:
            # Faster than the loss was noticed; what is there now knows neither setup nor, as a
            # driver, that it was started.
            self._code, self._end = 1, f"process {process} in place of {self._process}"
            return
        self._process = process
        self._received = int(status.get("received", 0))
        if state == "unconfigured":
            with self._optional("configure"):
                self._ask("configure", setup=msgspec.to_builtins(self._with_clock()))
            # The node makes sockets of its own in place of the one that waited.
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
        """Give the setup with the clock as measured, so that a node which answers at once stamps rightly from the first."""
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
        """Let a node refuse what is not needed of it; an answer that was lost on the way is asked for again."""
        try:
            yield
        except NoAnswerError:
            raise
        except ControlError as error:
            if needed:
                self._code, self._end = 1, f"{needed} refused: {error}"

    def _arrive(self) -> None:
        clock = ""
        if self._far:
            self._measure_well()
            offset, error = self._clock.best(time.monotonic())
            clock = f"; its clock is {-offset:+.6f} s from here, known to ±{error * 1e6:.0f} µs"
        self._say(f"{self.setup.name}: is there{clock}")

    def _measure_well(self, tell: bool = True) -> None:
        until = time.monotonic() + 1.0
        for _ in range(_ROUNDS):
            self._measure(tell)
            if time.monotonic() > until:
                break

    def _measure(self, tell: bool = True) -> None:
        """Measure the clock and tell the node; one that has no use for it (another language) may refuse."""
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
